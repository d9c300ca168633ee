"""A source unlike the virtual world: 19 classes, pinhole cameras that differ between scenes, labels of its own grid."""

from functools import cached_property
from pathlib import Path

import numpy as np
import torch

from omniocc.camera import Pinhole, Rig
from omniocc.classes import ClassTable, SemanticClass
from omniocc.data.labels.counts import all_frames, count_classes
from omniocc.data.source import SPLITS, Benchmark, BenchmarkFrame, Ignore, LidarScan, SourceSpec
from omniocc.geometry import Cuboid, Grid
from rayiou.directions import RayOrigins

CLASSES = ClassTable(tuple(SemanticClass(k, f"kind{k}", (10 * k, 255 - 10 * k, k)) for k in range(19)))
GRID = Cuboid((20, 16, 4), (-40.0, 40.0), (-32.0, 32.0), (-1.0, 5.4))
FRAMES = 3


def pinhole_rig(sizes, moved_m=0.0):
    """Cameras of these (width, height) px that look ahead, left, back and right from 1.5 m above the ego origin."""
    poses = []
    for k in range(len(sizes)):
        angle = k * np.pi / 2
        ahead, left = np.array([np.cos(angle), np.sin(angle), 0.0]), np.array([-np.sin(angle), np.cos(angle), 0.0])
        pose = np.eye(4)
        pose[:3, :3] = np.stack([-left, [0.0, 0.0, -1.0], ahead], axis=1)
        pose[:3, 3] = 0.3 * ahead + [moved_m, 0.0, 1.5]
        poses.append(pose)
    cameras = tuple(Pinhole(w, h, (w / 2, w / 2), ((w - 1) / 2, (h - 1) / 2)) for w, h in sizes)
    return Rig(cameras, torch.tensor(np.stack(poses)), tuple(f"camera{k}" for k in range(len(sizes))))


class FakeFrames:
    """A scene of noise whose cameras shake from frame to frame."""

    def __init__(self, name: str, number: int, with_lidar: bool = False):
        self.name, self.number, self.with_lidar = name, number, with_lidar
        self.sizes = [(64, 36)] * 4 if number % 2 == 0 else [(48, 32), (64, 24), (32, 32)]

    def __len__(self) -> int:
        return FRAMES

    @cached_property
    def rigs(self):
        return tuple(pinhole_rig(self.sizes, 0.01 * frame) for frame in range(FRAMES))

    @property
    def world_from_ego(self):
        poses = np.tile(np.eye(4), (FRAMES, 1, 1))
        poses[:, 0, 3] = np.arange(FRAMES)
        return poses

    def noise(self, frame):
        return np.random.default_rng([self.number, frame])

    def images(self, frame):
        return [self.noise(frame).integers(1, 256, (h, w, 3), dtype=np.uint8) for w, h in self.sizes]

    def pixel_labels(self, frame):
        return None

    def camera_range_m(self, frame):
        return None

    def erp_range_m(self, frame):
        return None

    def points(self, frame):
        return None

    def lidar(self, frame):
        if not self.with_lidar:
            return None
        rays = self.noise(frame).normal(size=(30 + frame, 3))
        directions = (rays / np.linalg.norm(rays, axis=1, keepdims=True)).astype(np.float32)
        labels = self.noise(frame).integers(1, 19, len(rays)).astype(np.uint8)
        return LidarScan(np.linspace(1, 45, len(rays), dtype=np.float32), labels, directions)


class FakeLabels:
    """Labels that come with the dataset; the last frame of a scene has none."""

    def prepare(self, scenes):
        pass

    def read(self, scene, frame):
        if frame == FRAMES - 1:
            return None
        cells = scene.noise(100 + frame).integers(0, 19, GRID.shape)
        return torch.from_numpy(np.where(scene.noise(frame).random(GRID.shape) < 0.2, cells, 0).astype(np.uint8))

    def benchmark(self, scene, frame):
        labels = self.read(scene, frame)
        mask = torch.from_numpy(scene.noise(200 + frame).random(GRID.shape) < 0.5)
        origins = RayOrigins(torch.zeros(1 + scene.number % 2, 3), torch.arange(1 + scene.number % 2))
        return None if labels is None else BenchmarkFrame(labels, mask, origins)

    def counts(self, scenes):
        return count_classes(self, all_frames(scenes), CLASSES.num_classes, GRID.shape)


class FakeSource:
    """A `SceneSource` that nothing outside the tests knows."""

    def __init__(self, folder: str, with_lidar: bool = False):
        self.folder, self.with_lidar = Path(folder), with_lidar
        self.fingerprint = "fake"
        self.spec = SourceSpec(CLASSES, (0.0, 20.0, 40.0), 0.1, 0.0, None, Benchmark(GRID))

    def prepare(self) -> None:
        pass

    def scenes(self, split):
        count = 4 if split == "train" else 2
        first = 10 * SPLITS.index(split)
        return [FakeFrames(f"{split}{k}", first + k, self.with_lidar) for k in range(count)]

    def labels(self, geometry: Grid, ignore: Ignore) -> FakeLabels:
        if geometry != GRID:
            raise ValueError(f"labels exist in {GRID} only, not in {geometry}")
        return FakeLabels()
