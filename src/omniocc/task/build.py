"""Build the occupancy task from a configuration; check what a checkpoint's configuration may be changed to."""

from collections.abc import Collection, Sequence
from pathlib import Path

from lightning.fabric.utilities.exceptions import MisconfigurationException
from lightning.pytorch import Trainer
from omegaconf import DictConfig, open_dict

from omniocc.config import OWN_PACKAGE, build, plain
from omniocc.data import SourceSpec, VirtualWorld
from omniocc.data.source import SceneFrames, SceneSource
from omniocc.data.store.files import is_url
from omniocc.errors import UserError, first_line
from omniocc.geometry import Grid
from omniocc.model import OccupancyModel
from omniocc.task.occupancy import OccupancyTask

PARTS = ("model", "loss", "optimizer", "augment")
"""Root keys from which a task is built."""
PLACES = ("root", "cache")
"""Arguments of a data source that name folders or URLs."""
MACHINE = ("accelerator", "devices", "strategy")
"""Arguments of the trainer that a machine may not have."""
NO_HEAD = "omniocc.model.semantic_head.NoSemanticHead"


def bare_trainer(trainer: DictConfig) -> Trainer:
    """Return the configured trainer without logger and checkpoints, to ask for its devices."""
    return build(trainer, logger=False, enable_checkpointing=False)


def check_devices(trainer: DictConfig) -> None:
    """Check that the trainer takes its values and this machine has what they ask for, before anything is made.

    Raises:
        UserError: naming the option.
    """
    try:
        bare_trainer(trainer)
    except MisconfigurationException as error:
        reason = first_line(error)
        named = [key for key in trainer if str(key) in reason and key not in MACHINE]
        asked = " ".join(f"trainer.{key}={trainer[key]}" for key in named or MACHINE)
        who = "the trainer" if named else "this machine"
        raise UserError(f"{asked}: {who} cannot do that ({reason})") from error


def switch_off_head(cfg: DictConfig, scenes: Sequence[SceneFrames]) -> str | None:
    """Switch the 2D head off if the training frames have no classes of pixels, and what looks its classes up.

    Returns:
        A line that says so; None if nothing was changed.
    """
    if not scenes or cfg.model.semantic_head._target_ == NO_HEAD or scenes[0].pixel_labels(0) is not None:
        return None
    with open_dict(cfg):
        cfg.model.semantic_head = {"_target_": NO_HEAD}
        cfg.model.hints.pixel_classes = False
    off = "model/semantic_head=none model.hints.pixel_classes=false"
    return f"the training frames have no classes of pixels, so the 2D head is left out: {off}"


def line_on_lifter(lifter: DictConfig, geometry: Grid) -> str | None:
    """Return a line where a lifter along rays ends before the grid does; None where it does not."""
    own = lifter._target_.partition(".")[0] in OWN_PACKAGE  # a lifter of another package may mean something else
    if not own or "range_m" not in lifter or not geometry.reaches_beyond(lifter.range_m[1]):
        return None
    return (
        f"model.lifter.range_m ends at {lifter.range_m[1]:g} m, but the grid reaches farther: nothing is lifted along "
        "the rays there; give a larger range, and more model.lifter.bins"
    )


def build_task(cfg: DictConfig, spec: SourceSpec, trained: OccupancyModel | None = None) -> OccupancyTask:
    """Return the task that a configuration describes for data with this spec, with fresh weights or a trained model.

    Raises:
        UserError: when parts do not fit together.
    """
    hints, lifter = cfg.model.hints, cfg.model.lifter
    if hints.pixel_classes and cfg.model.semantic_head._target_ == NO_HEAD:
        raise UserError("model.hints.pixel_classes=true needs a 2D head: choose model/semantic_head=fcn")
    if hints.queries != lifter.get("evidence", False):
        raise UserError(
            f"model.hints.queries={hints.queries} and this model/lifter do not fit: its key evidence must follow it; "
            "give false for a lifter without this key"
        )
    model = build(cfg.model) if trained is None else trained
    loss, optimizer, augment = (build(cfg[part]) for part in PARTS[1:])
    config = plain(cfg)
    factors = config.get("rate_factors") or {}  # checkpoints of older versions have none
    return OccupancyTask(model, loss, optimizer, augment, cfg.ema_decay, spec, config, factors)


def check_places(path: Path, source: SceneSource, given: Collection[str]) -> None:
    """Check that a file does not choose where data are fetched from or made, except below the working folder.

    Folders that exist are taken as they are, so that runs of this machine find their data again.

    Args:
        path: of the checkpoint.
        source: built from its configuration.
        given: keys that the command line sets, which may be anywhere.

    Raises:
        UserError: naming the place and the key that allows it.
    """
    for key in PLACES:
        place = getattr(source, key, None)
        if place is None or f"data.source.{key}" in given:
            continue
        inside = not is_url(str(place)) and Path(place).resolve().is_relative_to(Path.cwd())
        # scenes of the virtual world are rendered into a new folder of root, other sources only read there
        holds = source.folder if key == "cache" or isinstance(source, VirtualWorld) else Path(place)
        if not inside and (is_url(str(place)) or not holds.exists()):
            raise UserError(
                f"{path} names {place} for its data, which is not below this folder and holds no such data; to use "
                f"it, name it yourself: data.source.{key}={place}"
            )


def check_changes(path: Path, overrides: Sequence[str], parts: Sequence[str] = ("data", *PARTS)) -> None:
    """Check that overrides of a checkpoint's configuration have an effect on `parts`, and only the one that is meant.

    Raises:
        UserError: naming the override, and what to do instead.
    """
    known = ", ".join(parts)
    for key in (word.partition("=")[0] for word in overrides):
        part = key.partition(".")[0]
        if "/" in key:
            raise UserError(
                f"{key}: {path} keeps the options that it was trained with; single keys of "
                f"{known} can be changed, such as data.source.root=..."
            )
        if part not in parts:
            raise UserError(
                f"{key}: this has no effect on {path}; only keys of {known} can be changed, "
                "such as data.source.root=..."
            )
        if key == part:
            raise UserError(
                f"{key}: {path} keeps its {part}, of which single keys can be changed, such as data.source.root=...; "
                "scenes of another source are scored by python src/predict.py occupancy checkpoint=... recorded=..."
            )
        if key.startswith("model.geometry"):
            raise UserError(f"{key}: {path} was trained on its grid and can have no other")
