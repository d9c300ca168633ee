"""Train the stages of a configuration that are missing: what `src/train.py` does with its configuration."""

from collections.abc import Sequence

from omegaconf import DictConfig

from omniocc.config import check_root
from omniocc.data import OccupancyData
from omniocc.data.source.cameras import training_frames
from omniocc.parts import Parts
from omniocc.runs.distributed import is_first
from omniocc.runs.folder import given_checkpoint
from omniocc.runs.memory import keep_freed_memory
from omniocc.runs.plan import hours_line
from omniocc.runs.slots import slots_line
from omniocc.train.build import build_task, check_devices, line_on_lifter, without_unused_head
from omniocc.train.stage import Stage, announce
from omniocc.train.stage_keys import wanted_stages
from omniocc.train.stages import EarlierStage, stages_of
from omniocc.train.start import check_resumed, check_weights
from omniocc.train.step_time import rehearse, step_seconds


def train(cfg: DictConfig) -> None:
    """Check the configuration of `conf/train.yaml`, and run the missing stages, occupancy last.

    Raises:
        UserError, ConfigError: naming the key, file or part that cannot be used, before anything is trained.
    """
    check_root(cfg)
    keep_freed_memory()
    parts = Parts(cfg)
    check_devices(parts)
    data = parts.data()
    data.check_classes()
    last = "occupancy" in wanted_stages(cfg)
    lifter = check_last(parts, data) if last else None
    if cfg.plan:
        print(f"{'model':10}{slots_line(parts.config)}")
        announce_plan(stages_of(parts, data), training_frames(data.source), timed=True)
        return
    data.prepare_data()
    scenes = data.source.scenes("train")
    parts, without_head = without_unused_head(parts, scenes)
    stages, frames = stages_of(parts, data), sum(map(len, scenes))
    if last and (given := given_checkpoint(cfg.resume)) is not None:
        check_resumed(given, parts.config, stages[-1].amount(frames, parts.trainer()).steps)
    for line in filter(None, (without_head, lifter, *data.remarks())):
        announce(line)
    if is_first():
        announce_plan(stages, frames)
    if any(isinstance(stage, EarlierStage) and not stage.finished for stage in stages):
        rehearse(stages)
    for number, stage in enumerate(stages, start=1):
        stage.run(f"{stage.NAME}, stage {number} of {len(stages)}")


def check_last(parts: Parts, data: OccupancyData) -> str | None:
    """Check what the last stage starts from and that its parts fit together, before earlier stages are trained.

    Returns:
        A line where the lifter ends before the grid does.
    """
    given_checkpoint(parts.cfg.resume)
    if (weights := parts.cfg.stages.occupancy.weights) is not None:
        check_weights(weights, parts.cfg.resume)
    return line_on_lifter(build_task(parts, data.spec).model.lifter, data.geometry)


def announce_plan(stages: Sequence[Stage], frames: int, timed: bool = False) -> None:
    """Print how many steps, samples and epochs each stage takes on this many training frames, finished ones included.

    With `timed` the duration is measured as well.
    """
    trainer = stages[0].parts.trainer()
    if timed:
        announce("some steps of every stage are timed: seconds at preset=tiny, minutes for large sizes on a CPU")
    for stage in stages:
        if not stage.learns:
            announce(f"{stage.NAME:10}nothing to train")
            continue
        amount = stage.amount(frames, trainer)
        announce(f"{stage.NAME:10}{amount.line}")
        if timed:
            announce(f"{'':10}{hours_line(amount.steps, trainer.accumulate_grad_batches * step_seconds(stage))}")
