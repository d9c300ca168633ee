"""Windows of frames as training samples."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Bool, Float32, Float64, UInt8
from torch import Tensor
from torch.utils.data import Dataset

from omniocc.batch import Batch
from omniocc.camera import Rig
from omniocc.data.labels.voxels import VoxelCache
from omniocc.data.store.codec import decode_image, decode_labels, decode_lidar, decode_range
from omniocc.data.store.frame_cache import CandidateCache, RangeCache
from omniocc.data.store.reader import SceneReader


class Sample(NamedTuple):
    """One window; fields as in `Batch`, without its first axis."""

    images: UInt8[Tensor, "T N 3 H W"]
    rig: Rig
    world_from_ego: Float64[Tensor, "T 4 4"]
    voxels: UInt8[Tensor, "X Y Z"]
    pixel_labels: UInt8[Tensor, "N H W"]
    lidar_range_m: Float32[Tensor, " R"]
    lidar_labels: UInt8[Tensor, " R"]
    frame_id: str
    erp_range_m: Float32[Tensor, "h w"] | None = None
    camera_range_m: Float32[Tensor, "N H W"] | None = None
    depth_range_m: Float32[Tensor, "h w"] | None = None
    candidates: Bool[Tensor, "T X Y Z"] | None = None
    exists: Bool[Tensor, " T"] | None = None


class Extras(NamedTuple):
    """What a sample holds beyond the images and labels that every stage needs.

    Attributes:
        true_ranges: of the panorama and of every pixel.
        depth: panoramas that the depth stage predicted.
        candidates: voxels that the sketch stage chose.
    """

    true_ranges: bool = False
    depth: RangeCache | None = None
    candidates: CandidateCache | None = None


class WindowDataset(Dataset):
    """Every recorded frame once, as the newest of a window of T consecutive frames of its scene.

    Where a scene has not begun T frames ago, its first frame stands in, and `exists` says so.

    Args:
        scenes: recorded scenes.
        voxels: labels in the wanted geometry.
        window: T.
        extras: what else is read.
    """

    def __init__(self, scenes: Sequence[SceneReader], voxels: VoxelCache, window: int, extras: Extras | None = None):
        if window < 1:
            raise ValueError(f"window must be at least 1 frame, got {window}")
        self.scenes = tuple(scenes)
        self.voxels = voxels
        self.window = window
        self.extras = extras or Extras()
        self._ends = np.cumsum([len(scene) for scene in self.scenes])

    def __len__(self) -> int:
        return int(self._ends[-1]) if len(self._ends) else 0

    def locate(self, index: int) -> tuple[SceneReader, int]:
        """Scene and frame number of a sample's newest frame."""
        if not 0 <= index < len(self):
            raise IndexError(f"sample {index} of {len(self)}")
        at = int(np.searchsorted(self._ends, index, side="right"))
        return self.scenes[at], index - (int(self._ends[at - 1]) if at else 0)

    def __getitem__(self, index: int) -> Sample:
        scene, newest = self.locate(index)
        frames = window_frames(newest, self.window)
        rig = scene.rig
        cameras = range(len(rig.cameras))
        members = [f"semantic{k}.zst" for k in cameras] + ["lidar.zst"]
        blobs = scene.read(newest, members)
        range_m, labels = decode_lidar(blobs["lidar.zst"])
        depth, candidates = self.extras.depth, self.extras.candidates
        images = {frame: read_images(scene, frame) for frame in set(frames)}
        erp_range_m, camera_range_m = read_true_ranges(scene, newest) if self.extras.true_ranges else (None, None)
        return Sample(
            images=torch.stack([images[frame] for frame in frames]),
            rig=rig,
            world_from_ego=torch.from_numpy(scene.world_from_ego[frames]),
            voxels=self.voxels.read(scene, newest),
            pixel_labels=torch.from_numpy(np.stack([decode_labels(blobs[f"semantic{k}.zst"]) for k in cameras])),
            lidar_range_m=torch.from_numpy(range_m),
            lidar_labels=torch.from_numpy(labels),
            frame_id=f"{scene.name}/{newest:06d}",
            erp_range_m=erp_range_m,
            camera_range_m=camera_range_m,
            depth_range_m=depth and depth.read(scene.name, newest),
            candidates=candidates and torch.stack([candidates.read(scene.name, frame) for frame in frames]),
            exists=torch.arange(newest - self.window + 1, newest + 1) >= 0,
        )


def window_frames(newest: int, window: int) -> list[int]:
    """Numbers of the frames of a window, oldest first; never before the scene's first."""
    return [max(0, frame) for frame in range(newest - window + 1, newest + 1)]


def read_images(scene: SceneReader, frame: int) -> UInt8[Tensor, "N 3 H W"]:
    """All cameras' colour images of a frame."""
    names = [f"rgb{k}.jpg" for k in range(len(scene.rig.cameras))]
    blobs = scene.read(frame, names)
    images = np.stack([decode_image(blobs[name]) for name in names])
    return torch.from_numpy(images).permute(0, 3, 1, 2).contiguous()


def read_true_ranges(scene: SceneReader, frame: int) -> tuple[Float32[Tensor, "h w"], Float32[Tensor, "N H W"]]:
    """Panorama and cameras' ranges of a frame; see `Batch`."""
    names = ["erp_range.zst", *(f"range{k}.zst" for k in range(len(scene.rig.cameras)))]
    blobs = scene.read(frame, names)
    erp, *cameras = (torch.from_numpy(decode_range(blobs[name])) for name in names)
    return erp, torch.stack(cameras)


def collate(samples: Sequence[Sample]) -> Batch:
    """Stack samples along a new first axis."""
    columns = dict(zip(Sample._fields, zip(*samples, strict=True), strict=True))
    rigs, frame_ids = columns.pop("rig"), columns.pop("frame_id")
    # an extra that was not asked for is None in every sample
    stacked = {name: None if column[0] is None else torch.stack(column) for name, column in columns.items()}
    return Batch(rigs=rigs, frame_ids=frame_ids, **stacked)  # type: ignore[arg-type]
