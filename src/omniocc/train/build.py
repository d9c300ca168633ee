"""The occupancy task of a configuration, and what is checked of it before anything is made."""

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from lightning.fabric.utilities.exceptions import MisconfigurationException
from omegaconf import OmegaConf

from omniocc.config import ConfigError
from omniocc.data import SourceSpec
from omniocc.data.source import SceneFrames
from omniocc.errors import UserError, first_line
from omniocc.geometry import Grid
from omniocc.model import OccupancyModel
from omniocc.model.protocols import Lifter, takes_true_range
from omniocc.parts import Parts
from omniocc.runs.machine import memory_bytes
from omniocc.train.occupancy import OccupancyTask
from omniocc.train.stage_keys import wanted_stages

MACHINE = ("accelerator", "devices", "strategy")
"""Arguments of the trainer that a machine may not have."""


def check_devices(parts: Parts) -> None:
    """Check that the trainer takes its values and this machine has what they ask for, before anything is made.

    Raises:
        UserError: naming the option.
    """
    try:
        parts.trainer()
    except (MisconfigurationException, MemoryError, AttributeError, TypeError, ValueError) as error:
        trainer = parts.cfg.trainer
        reason = "; ".join(error.problems) if isinstance(error, ConfigError) else first_line(error)
        named = [key for key in trainer if str(key) in reason and key not in MACHINE]
        asked = " ".join(f"trainer.{key}={trainer[key]}" for key in named or MACHINE)
        who = "the trainer" if named else "this machine"
        raise UserError(f"{asked}: {who} cannot do that ({reason})") from error


def check_memory(parts: Parts) -> None:
    """Check that the machine can hold the arrays of a step that no option of the model avoids.

    Raises:
        UserError: naming the keys of one that needs more than all memory, with both figures.
    """
    most = memory_bytes(parts.trainer().strategy.root_device)
    for keys, needed in least_bytes(parts.config, wanted_stages(parts.cfg)):
        if needed > most:
            sizes = f"at least {needed / 2**30:,.0f} GiB, and there are {most / 2**30:,.0f} GiB of memory"
            raise UserError(f"{keys}: one step takes {sizes}; choose smaller numbers")


def least_bytes(config: Mapping[str, Any], stages: Sequence[str]) -> Iterator[tuple[str, int]]:
    """Yield the keys and bytes of an array in a step of every stage: ranges, logits of cells, half-precision features.

    Parts of others may lack the keys: what a configuration does not say counts as 1.
    """
    shape = config["data"]["geometry"].get("shape", [])
    cells, grid = math.prod(shape), f"model.geometry.shape={shape}"
    batch = {stage: config["stages"][stage]["batch_size"] for stage in stages}
    if "depth" in batch:
        panorama = config["depth"].get("panorama") or {}
        width, height = panorama.get("width", 1), panorama.get("height", 1)
        keys = f"stages.depth.batch_size={batch['depth']} depth.panorama.width={width} depth.panorama.height={height}"
        yield keys, 4 * batch["depth"] * width * height
    if "sketch" in batch:
        yield f"stages.sketch.batch_size={batch['sketch']} {grid}", 4 * batch["sketch"] * cells
    if "occupancy" in batch:
        channels = config["model"]["lifter"].get("channels", 1)
        keys = f"data.batch_size={batch['occupancy']} {grid} model.lifter.channels={channels}"
        yield keys, 2 * batch["occupancy"] * cells * channels


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
    if parts.cfg.augment.get("disturbances") and takes_true_range(model.sketch):
        raise UserError(
            "augment=disturbed: the ranges of model/depth=truth are the recorded ones, which nothing disturbs; choose "
            "another model/depth, or augment=default"
        )
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
        occupied_above=config.get("occupied_above"),
        seed=seed,
    )
