"""Training steps of every stage on random inputs: their time on this machine, and whether the parts fit together."""

import time
import warnings
from collections.abc import Sequence
from typing import cast

import torch
from torch import Tensor

from omniocc.batch import Batch, to_device
from omniocc.camera import Rig
from omniocc.data.source.cameras import training_rig
from omniocc.model.protocols import Depth
from omniocc.train.stage import Stage

OCCUPIED, CANDIDATES = 0.1, 0.25
"""Fractions of voxels, about those of the virtual world."""
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
    )
