"""Training steps of every stage on random inputs: their time on this machine, and whether the parts fit together."""

import time
import warnings
from collections.abc import Sequence
from typing import cast

import torch
from omegaconf import DictConfig
from torch import Tensor

from omniocc.batch import Batch, to_device
from omniocc.camera import Rig
from omniocc.config import build, plain, target_of
from omniocc.data import SceneSource, SourceSpec, VirtualWorld
from omniocc.data.source.cameras import training_rig
from omniocc.model.protocols import Depth, learns
from omniocc.task.build import build_task
from omniocc.task.depth import DepthTask
from omniocc.task.sketch import SketchTask
from omniocc.task.stage_task import StageTask

OCCUPIED, CANDIDATES = 0.1, 0.25
"""Fractions of voxels, about those of the virtual world."""
WARM_UP = 2
"""Steps that are not measured: tables of the rig are made in the first."""


def step_seconds(
    cfg: DictConfig, stage: str, rig: Rig, spec: SourceSpec, device: torch.device, steps: int = 3
) -> float:
    """Return the seconds of a step: the best of `steps`, after others that warm up; reading samples is not included.

    Other arguments are those of `train_on_noise`.
    """
    return min(train_on_noise(cfg, stage, rig, spec, device, WARM_UP + steps)[WARM_UP:])


def rehearse(cfg: DictConfig, stages: Sequence[str], rig: Rig, spec: SourceSpec, device: torch.device) -> None:
    """Train one step of every stage on noise, so that parts that do not fit together fail before hours of training.

    Raises:
        UserError: naming the part of the model whose output has a wrong shape.
    """
    for stage in stages:
        if stage != "depth" or learns(target_of(cfg.depth)):
            train_on_noise(cfg, stage, rig, spec, device, 1)


def train_on_noise(
    cfg: DictConfig, stage: str, rig: Rig, spec: SourceSpec, device: torch.device, steps: int
) -> list[float]:
    """Train a stage from nothing on random samples, and return the seconds of every step.

    Args:
        cfg: checked configuration.
        stage: depth, sketch or occupancy.
        rig: cameras of every sample.
        spec: of the data.
        device: on which the stage is trained.
        steps: of the optimizer.
    """
    task = make_task(cfg, stage, rig, spec).to(device).train()
    size = cfg.data.batch_size if stage == "occupancy" else cfg.stages[stage].batch_size
    batch = to_device(random_batch(cfg, rig, size, cfg.data.window if stage == "occupancy" else 1), device)
    optimizer = task.optimizer.configure(task.model, steps)["optimizer"]
    low = str(cfg.trainer.precision).startswith("bf16")
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


def make_task(cfg: DictConfig, stage: str, rig: Rig, spec: SourceSpec) -> StageTask:
    """Return the task of a stage, with fresh weights."""
    if stage == "occupancy":
        return build_task(cfg, spec)
    optimizer = build(cfg.stages[stage]).optimizer
    if stage == "sketch":
        return SketchTask(build(cfg.model.sketch), optimizer, spec.range_edges_m, plain(cfg))
    model = build(cfg.depth)
    spheres = cast(Depth, model).rig_spheres(rig)
    return DepthTask(model, optimizer, spheres, spec.range_edges_m, cfg.seed, plain(cfg))


def random_batch(cfg: DictConfig, rig: Rig, size: int, window: int) -> Batch:
    """Return windows of noise with every input and label that a stage may use."""
    shape, panorama = build(cfg.model.geometry).shape, build(cfg.depth).panorama
    cameras, width, height = len(rig.cameras), rig.cameras[0].width, rig.cameras[0].height
    occupied = torch.rand(size, *shape) < OCCUPIED
    classes = cfg.data.num_classes
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
    )


def planned_scenes(source: SceneSource) -> tuple[Rig, int]:
    """Return cameras and number of training frames of a source; scenes of the virtual world may be missing."""
    if isinstance(source, VirtualWorld):
        return training_rig(source), source.num_scenes["train"] * source.frames_per_scene
    return training_rig(source), sum(map(len, source.scenes("train")))
