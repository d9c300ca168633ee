"""Recorded scenes of random patches, points and ranges at the size of `preset=smoke`, and checkpoints."""

from pathlib import Path

import cv2
import numpy as np
import torch
from omegaconf import DictConfig

from omniocc.camera import Rig
from omniocc.camera.pose import pose_from_angles
from omniocc.config import plain
from omniocc.data import SourceSpec
from omniocc.data.recording.spec import plain_spec
from omniocc.data.store.codec import encode_frame
from omniocc.data.store.shard import SceneWriter
from omniocc.run.checkpoint import CONFIG, STAGE
from omniocc.task.build import build_task
from omniocc.world.frame import Frame

RIG = Rig.load("fisheye6").resized(64, 36)


def make_frame(index: int, num_classes: int) -> Frame:
    rng = np.random.default_rng(index)
    range_m = rng.uniform(0.5, 60, (6, 36, 64)).astype(np.float32)
    # a car that turns; patches instead of noise, which JPEG would blur
    patches = rng.integers(0, 256, (6, 6, 8, 3), dtype=np.uint8)
    level = pose_from_angles((0.0, 0.0, 0.0), 0.0, 0.0, 0.0).inverse()
    pose = pose_from_angles((2.3 * index, 0.4 * index, 0.0), 11.0 * index, 0.0, 0.0) @ level
    return Frame(
        time_s=0.5 * index,
        world_from_ego=pose.numpy(),
        images=np.stack([cv2.resize(patch, (64, 36), interpolation=cv2.INTER_NEAREST) for patch in patches]),
        semantics=np.zeros((6, 36, 64), np.uint8),
        range_m=range_m,
        erp_range_m=rng.uniform(0.5, 60, (12, 48)).astype(np.float32),
        points_m=rng.uniform([-20, -20, -2.5], [20, 20, 3], (3000, 3)).astype(np.float32),
        point_labels=rng.integers(1, num_classes, 3000).astype(np.uint8),
        lidar_range_m=rng.uniform(1, 50, 14040).astype(np.float32),
        lidar_labels=rng.integers(1, num_classes, 14040).astype(np.uint8),
        boxes=(),
    )


def write_scene(folder: Path, spec: SourceSpec, frames: int, first: int = 0) -> Path:
    writer = SceneWriter(folder)
    for index in range(frames):
        frame = make_frame(first + index, spec.classes.num_classes)
        entry = {"time_s": frame.time_s, "world_from_ego": frame.world_from_ego.tolist()}
        writer.append(encode_frame(frame), entry)
    writer.attach("rig.yaml", RIG.save)
    writer.finish({"split": "test", "spec": plain_spec(spec)})
    writer.close()
    return folder


def write_checkpoint(path: Path, cfg: DictConfig, spec: SourceSpec, seed: int = 3) -> Path:
    """Write a checkpoint of the last stage with random weights, which predict many classes."""
    torch.manual_seed(seed)
    task = build_task(cfg, spec)
    torch.nn.init.normal_(task.model.classifier.linear.weight)
    path.parent.mkdir(parents=True, exist_ok=True)
    torch.save({STAGE: "occupancy", CONFIG: plain(cfg), "state_dict": task.state_dict()}, path)
    return path
