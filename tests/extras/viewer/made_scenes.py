"""Recorded scenes with random content and a model with random weights, at the size of `preset=smoke`."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import torch
from omegaconf import DictConfig

from omniocc.camera import Rig
from omniocc.camera.pose import pose_from_angles
from omniocc.config import plain
from omniocc.data import SourceSpec
from omniocc.data.store.meta import append_frame, finish_scene
from omniocc.data.store.shard import SceneWriter
from omniocc.frame import Frame
from omniocc.parts import Parts
from omniocc.runs.checkpoint import CONFIG, STAGE
from omniocc.train.build import build_task

RIG = Rig.load("fisheye6").resized(64, 36)
MASKED = replace(RIG, masks=tuple(torch.arange(36)[:, None].expand(36, 64) < 30 for _ in RIG.names))
FRAMES = 3
SCENES = ("test-000-here", "test-001-there")


def make_frame(index: int, num_classes: int = 12) -> Frame:
    """Return a frame of random content: ground at -2 m whose patches have any class, and a wall in front."""
    rng = np.random.default_rng(index)
    patches = rng.integers(0, 256, (6, 6, 8, 3), dtype=np.uint8)
    ground = rng.uniform([-20, -20, -2.0], [20, 20, -1.9], (3000, 3))
    kinds = 1 + (ground // 4).astype(int) @ (1, 3, 0) % (num_classes - 1)
    wall = rng.uniform([8, -10, -2], [9, 10, 3], (3000, 3))
    pose = pose_from_angles((2.3 * index, 0.4 * index, 0.0), 11.0 * index, 0.0, 0.0)
    return Frame(
        time_s=0.5 * index,
        world_from_ego=pose.numpy(),
        images=np.stack([cv2.resize(patch, (64, 36), interpolation=cv2.INTER_NEAREST) for patch in patches]),
        semantics=rng.integers(0, num_classes, (6, 36, 64), dtype=np.uint8),
        range_m=rng.uniform(0.5, 60, (6, 36, 64)).astype(np.float32),
        erp_range_m=rng.uniform(0.5, 60, (12, 48)).astype(np.float32),
        points_m=np.concatenate([ground, wall]).astype(np.float32),
        point_labels=np.concatenate([kinds, np.full(3000, 4)]).astype(np.uint8),
        lidar_range_m=rng.uniform(1, 50, 14040).astype(np.float32),
        lidar_labels=rng.integers(0, num_classes, 14040).astype(np.uint8),
        boxes=(),
    )


def write_scene(folder: Path, spec: SourceSpec, first: int = 0, frames: int = FRAMES, rig: Rig = MASKED) -> Path:
    """Write a recorded scene of a few frames."""
    writer = SceneWriter(folder)
    for index in range(frames):
        append_frame(writer, make_frame(first + index, spec.classes.num_classes))
    finish_scene(writer, rig, spec, (45.0, -45.0), {"split": "test"})
    writer.close()
    return folder


def write_checkpoint(path: Path, cfg: DictConfig, spec: SourceSpec, seed: int = 3) -> Path:
    """Write a checkpoint of the last stage with random weights, which predict many classes."""
    torch.manual_seed(seed)
    task = build_task(Parts(cfg), spec)
    torch.nn.init.normal_(task.model.classifier.linear.weight)
    path.parent.mkdir(parents=True, exist_ok=True)
    torch.save({STAGE: "occupancy", CONFIG: plain(cfg), "state_dict": task.state_dict()}, path)
    return path
