"""Train the stages of a configuration that are missing: what `src/train.py` does with its configuration."""

import time
import warnings
from collections.abc import Sequence
from typing import cast

import torch
from omegaconf import DictConfig
from torch import Tensor

from omniocc.batch import Batch, to_device
from omniocc.camera import Rig
from omniocc.config import check_root
from omniocc.data import OccupancyData
from omniocc.data.source import MadeScenes, SceneSource
from omniocc.data.source.cameras import frames_in, training_frames, training_rig
from omniocc.errors import UserError
from omniocc.model.protocols import Depth
from omniocc.parts import Parts
from omniocc.runs.distributed import is_first
from omniocc.runs.folder import WITHOUT_START, given_checkpoint
from omniocc.runs.machine import keep_freed_memory
from omniocc.runs.plan import hours_line, validation_times
from omniocc.runs.slots import slots_line
from omniocc.train.build import build_task, check_devices, check_memory, line_on_lifter, without_unused_head
from omniocc.train.stage import Stage, announce
from omniocc.train.stage_keys import wanted_stages
from omniocc.train.stages import EarlierStage, stages_of
from omniocc.train.start import check_resumed, check_weights


def train(cfg: DictConfig) -> None:
    """Check the configuration of `conf/train.yaml`, and run the missing stages, occupancy last.

    Raises:
        UserError, ConfigError: naming the key, file or part that cannot be used, before anything is trained.
    """
    check_root(cfg)
    check_keys(cfg)
    keep_freed_memory()
    parts = Parts(cfg)
    check_devices(parts)
    check_memory(parts)
    data = parts.data()
    data.check_classes()
    last = "occupancy" in wanted_stages(cfg)
    lifter = check_last(parts, data) if last else None
    if cfg.plan:
        print(f"{'model':10}{slots_line(parts.config)}")
        announce_plan(stages_of(parts, data), training_frames(data.source), timed=True)
        return
    if isinstance(data.source, MadeScenes):
        check_frames(stages_of(parts, data), data.source)
    data.prepare_data()
    scenes = data.source.scenes("train")
    parts, without_head = without_unused_head(parts, scenes)
    stages, frames = stages_of(parts, data), sum(map(len, scenes))
    check_frames(stages, data.source)
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


def check_keys(cfg: DictConfig) -> None:
    """Raise UserError if a key would have no effect: it is for a stage that is left out, or each stage has its own."""
    last = wanted_stages(cfg)[-1]
    for key in ("resume", "weights"):
        if last != "occupancy" and cfg[key] not in (None, *WITHOUT_START):
            raise UserError(
                f"{key}={cfg[key]} is for the occupancy stage, which stage={last} leaves out; "
                f"stages.{last}.weights=... is for this one"
            )
    recipe, every = cfg.stages[last], "val_check_interval"
    lengths = recipe.max_steps, recipe.max_epochs, recipe.validate_every_n_epochs
    if every in cfg.trainer and every in validation_times(*lengths, cfg.trainer.accumulate_grad_batches):
        raise UserError(
            f"trainer.{every}={cfg.trainer[every]} has no effect: steps end the training, and validations are spread "
            f"over it; with stages.{last}.validate_every_n_epochs=1 it counts"
        )
    if cfg.data.seed != cfg.seed:
        raise UserError(
            f"data.seed={cfg.data.seed} has no effect: the order of samples follows from stages.<stage>.seed, by "
            "default from seed"
        )


def check_last(parts: Parts, data: OccupancyData) -> str | None:
    """Check what the last stage starts from and that its parts fit together, before earlier stages are trained.

    Returns:
        A line where the lifter ends before the grid does.
    """
    given_checkpoint(parts.cfg.resume)
    if (weights := parts.cfg.stages.occupancy.weights) is not None:
        check_weights(weights, parts.cfg.resume)
    return line_on_lifter(build_task(parts, data.spec).model.lifter, data.geometry)


def check_frames(stages: Sequence[Stage], source: SceneSource) -> None:
    """Check that every split has frames, and training enough for a step of every stage that is trained.

    Raises:
        UserError: naming the split or the stage.
    """
    trainer, frames = stages[0].parts.trainer(), training_frames(source)
    devices = trainer.num_devices * trainer.num_nodes
    for split in ("val", "test"):
        if not (count := frames_in(source, split)):
            raise UserError(f"the split '{split}' has no frames, but every stage is scored on it: give it scenes")
        if count < devices:
            frames_of = f"{count} frame{'s' * (count > 1)} for {devices} devices"
            raise UserError(f"the split '{split}' has {frames_of}, and each device needs one: give it more scenes")
    for stage in stages:
        amount, key = stage.amount(frames, trainer), f"stages.{stage.NAME}.batch_size"
        if stage.learns and stage.recipe.max_steps and not amount.steps_of_epoch:
            keys = f"{'data.batch_size' if stage.NAME == 'occupancy' else key}={amount.batch_size}"
            keys += f" trainer.accumulate_grad_batches={amount.accumulated}" if amount.accumulated > 1 else ""
            raise UserError(
                f"{keys}: there are {frames} training frames, less than the {amount.samples} of a step on "
                f"{amount.devices} device{'s' * (amount.devices > 1)}; use more scenes or smaller batches"
            )


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


OCCUPIED, CANDIDATES = 0.1, 0.25
"""Fractions of voxels, about those of the virtual world."""
SCAN_RAYS = 14_040
"""Measured rays, as many as one LiDAR of the virtual world has."""
WARM_UP = 2
"""Steps that are not measured: tables of the rig are made in the first."""


def step_seconds(stage: Stage, steps: int = 3) -> float:
    """Return the seconds of a step: the best of `steps`, after others that warm up; reading samples is not included."""
    return min(train_on_noise(stage, WARM_UP + steps)[WARM_UP:])


def rehearse(stages: Sequence[Stage]) -> None:
    """Train one step of every stage on noise, so that parts that do not fit together fail before hours of training.

    Raises:
        UserError: naming the part of the model whose output has a wrong shape.
    """
    for stage in stages:
        if stage.learns:
            train_on_noise(stage, 1)


def train_on_noise(stage: Stage, steps: int) -> list[float]:
    """Train a stage from nothing on random samples, and return the seconds of every optimiser step.

    The device and the cameras are those of the training; no data are read where its scenes are planned.
    """
    rig, device = training_rig(stage.data.source), stage.parts.trainer().strategy.root_device
    task = stage.task(rig).to(device).train()
    batch = to_device(random_batch(stage, rig), device)
    optimizer = task.optimizer.configure(task.model, steps)["optimizer"]
    low = str(stage.parts.cfg.trainer.precision).startswith("bf16")
    seconds = []
    for number in range(steps):
        start_s = time.perf_counter()
        with warnings.catch_warnings(), torch.autocast(device.type, torch.bfloat16, enabled=low):
            warnings.filterwarnings("ignore", message=".*self.log.*")  # there is no trainer
            loss = cast(Tensor, task.training_step(batch, number))
        loss.backward()
        optimizer.step()
        optimizer.zero_grad()
        loss.item()  # waits until the device has done all of the step
        seconds.append(time.perf_counter() - start_s)
    return seconds


def random_batch(stage: Stage, rig: Rig) -> Batch:
    """Return windows of noise with every input and label that a stage may use."""
    shape, panorama = stage.data.geometry.shape, cast(Depth, stage.parts.depth()).panorama
    size, window, classes = stage.recipe.batch_size, stage.window, stage.data.num_classes
    cameras, width, height = len(rig.cameras), rig.cameras[0].width, rig.cameras[0].height
    occupied = torch.rand(size, *shape) < OCCUPIED
    poses = torch.eye(4, dtype=torch.float64).repeat(size, window, 1, 1)
    poses[..., 0, 3] = torch.arange(window)
    range_m = 1 + 20 * torch.rand(size, panorama.height, panorama.width)
    return Batch(
        images=torch.randint(0, 256, (size, window, cameras, 3, height, width), dtype=torch.uint8),
        rigs=((rig,) * window,) * size,
        world_from_ego=poses,
        frame_ids=("noise",) * size,
        voxels=(torch.randint(1, classes, (size, *shape)) * occupied).to(torch.uint8),
        pixel_labels=torch.randint(0, classes, (size, cameras, height, width), dtype=torch.uint8),
        erp_range_m=range_m,
        camera_range_m=1 + 20 * torch.rand(size, cameras, height, width),
        depth_range_m=range_m,
        candidates=torch.rand(size, window, *shape) < CANDIDATES,
        evidence=torch.randint(0, 256, (size, window, *shape), dtype=torch.uint8),
        scan_origins=torch.zeros(size, SCAN_RAYS, 3),
        scan_ends=20 * torch.randn(size, SCAN_RAYS, 3),
        scan_labels=torch.randint(0, classes, (size, SCAN_RAYS), dtype=torch.uint8),
    )
