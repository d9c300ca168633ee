"""The occupancy task of a configuration, and what is checked of it before anything is made."""

from collections.abc import Sequence

from lightning.fabric.utilities.exceptions import MisconfigurationException
from omegaconf import OmegaConf

from omniocc.data import SourceSpec
from omniocc.data.source import SceneFrames
from omniocc.errors import UserError, first_line
from omniocc.geometry import Grid
from omniocc.model import OccupancyModel
from omniocc.model.protocols import Lifter
from omniocc.parts import Parts
from omniocc.train.occupancy import OccupancyTask

MACHINE = ("accelerator", "devices", "strategy")
"""Arguments of the trainer that a machine may not have."""


def check_devices(parts: Parts) -> None:
    """Check that the trainer takes its values and this machine has what they ask for, before anything is made.

    Raises:
        UserError: naming the option.
    """
    try:
        parts.trainer()
    except MisconfigurationException as error:
        reason, trainer = first_line(error), parts.cfg.trainer
        named = [key for key in trainer if str(key) in reason and key not in MACHINE]
        asked = " ".join(f"trainer.{key}={trainer[key]}" for key in named or MACHINE)
        who = "the trainer" if named else "this machine"
        raise UserError(f"{asked}: {who} cannot do that ({reason})") from error


def without_unused_head(parts: Parts, scenes: Sequence[SceneFrames]) -> tuple[Parts, str | None]:
    """Return the parts for training scenes, and a line if the 2D head is off since they have no classes of pixels."""
    if not scenes or not parts.has_head or scenes[0].pixel_labels(0) is not None:
        return parts, None
    off = "model/semantic_head=none model.hints.pixel_classes=false"
    line = f"the training frames have no classes of pixels, so the 2D head is left out: {off}"
    return parts.without_head(), line


def line_on_lifter(lifter: Lifter, geometry: Grid) -> str | None:
    """Return a line where a lifter along rays ends before the grid does; None where it does not."""
    reach_m = getattr(lifter, "reach_m", None)
    if reach_m is None or not geometry.reaches_beyond(reach_m):
        return None
    return (
        f"model.lifter.range_m ends at {reach_m:g} m, but the grid reaches farther: nothing is lifted along "
        "the rays there; give a larger range, and more model.lifter.bins"
    )


def build_task(parts: Parts, spec: SourceSpec, trained: OccupancyModel | None = None) -> OccupancyTask:
    """Return the task that a configuration describes for data with this spec, with fresh weights or a trained model.

    Raises:
        UserError: when parts do not fit together.
    """
    hints, lifter = parts.cfg.model.hints, parts.cfg.model.lifter
    if hints.pixel_classes and not parts.has_head:
        raise UserError("model.hints.pixel_classes=true needs a 2D head: choose model/semantic_head=fcn")
    if hints.queries != lifter.get("evidence", False):
        raise UserError(
            f"model.hints.queries={hints.queries} and this model/lifter do not fit: its key evidence must follow it; "
            "give false for a lifter without this key"
        )
    model = parts.model() if trained is None else trained
    config = parts.config
    factors = config.get("lr_multipliers") or {}  # checkpoints of older versions have none
    seed = OmegaConf.select(parts.cfg, "stages.occupancy.seed", default=config["seed"])
    return OccupancyTask(
        model,
        *parts.task_parts(),
        ema_decay=parts.cfg.ema_decay,
        spec=spec,
        config=config,
        lr_multipliers=factors,
        seed=seed,
    )
