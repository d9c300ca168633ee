"""Batches: the data that tasks and models receive."""

from typing import NamedTuple

import torch
from jaxtyping import Bool, Float32, Float64, Int64, UInt8
from torch import Tensor

from omniocc.camera import Rig


class Batch(NamedTuple):
    """Windows of T frames, oldest first; all labels belong to the newest frame, in its ego frame.

    Fields with `| None` are absent if the dataset does not have them or no stage needs them (`omniocc.data.Needs`).
    Absent data gives no loss and no score. If only some samples have it, it is filled with 'unknown' (label 255, range
    nan) for the others, which gives no loss and no score either.

    Samples may differ in the number of cameras and in the sizes of their images, which are padded at the end of
    the axes of cameras, rows and columns. `image_mask` is the mask of true pixels.

    Attributes:
        images: RGB, 0..255; 0 where padded; without cameras if no stage needs them.
        rigs: cameras of every frame of every sample, `rigs[sample][frame]`; frames share it if nothing moved.
        world_from_ego: pose of every frame of the window.
        frame_ids: `scene/frame` of the newest frame, for messages and saved images.
        voxels: class of every cell, 255 unknown.
        own_voxels: the same on the dataset's own grid, on which it is scored. None: `voxels` are scored.
        scored: cells of the grid that is scored that count. None: all whose class is known.
        ray_origins: starts of RayIoU's rays, m, ego frame; nan where a sample has fewer. None: the ego origin.
        ray_times: frames from the scored one to that of each of these origins: below 0 past, above 0 future.
        pixel_labels: class of every pixel; 0 sky, 255 own car, outside the lens or padded.
        lidar_range_m: true range along the LiDAR's rays, inf where nothing is hit or padded.
        lidar_labels: true class along these rays, 0 where nothing is hit, 255 unknown or padded.
        lidar_directions: unit rays in the ego frame. None: those of the source, `SourceSpec.lidar_directions`.
        lidar_origins: where the rays start, m, ego frame. None: in the ego origin.
        lidar_moving: whether what these rays hit moves. None: the dataset does not tell.
        scan_origins: where measured rays start from which training learns, m, ego frame; nan where a sample has fewer.
        scan_ends: where these rays end, m, ego frame.
        scan_labels: class at their ends; 0 where nothing was hit before, 255 where the class is unknown.
        erp_range_m: true panorama of range around the ego origin, inf for sky, nan unknown.
        camera_range_m: true range of every pixel; inf for sky, nan for own car, outside the lens or padded.
        depth_range_m: panorama that the depth stage predicted, nan where unknown.
        candidates: voxels that the sketch stage selected in every frame of the window.
        evidence: bits of what the sketch stage knows of every voxel, see `omniocc.model.ops.evidence`.
        exists: which frames of the window were recorded; others are copies of a scene's first. None: all.
    """

    images: UInt8[Tensor, "B T N 3 H W"]
    rigs: tuple[tuple[Rig, ...], ...]
    world_from_ego: Float64[Tensor, "B T 4 4"]
    frame_ids: tuple[str, ...]
    voxels: UInt8[Tensor, "B X Y Z"] | None = None
    own_voxels: UInt8[Tensor, "B U V W"] | None = None
    scored: Bool[Tensor, "B U V W"] | None = None
    ray_origins: Float32[Tensor, "B O 3"] | None = None
    ray_times: Int64[Tensor, "B O"] | None = None
    pixel_labels: UInt8[Tensor, "B N H W"] | None = None
    lidar_range_m: Float32[Tensor, "B R"] | None = None
    lidar_labels: UInt8[Tensor, "B R"] | None = None
    lidar_directions: Float32[Tensor, "B R 3"] | None = None
    lidar_origins: Float32[Tensor, "B R 3"] | None = None
    lidar_moving: Bool[Tensor, "B R"] | None = None
    scan_origins: Float32[Tensor, "B S 3"] | None = None
    scan_ends: Float32[Tensor, "B S 3"] | None = None
    scan_labels: UInt8[Tensor, "B S"] | None = None
    erp_range_m: Float32[Tensor, "B h w"] | None = None
    camera_range_m: Float32[Tensor, "B N H W"] | None = None
    depth_range_m: Float32[Tensor, "B h w"] | None = None
    candidates: Bool[Tensor, "B T X Y Z"] | None = None
    evidence: UInt8[Tensor, "B T X Y Z"] | None = None
    exists: Bool[Tensor, "B T"] | None = None

    @property
    def newest_rigs(self) -> tuple[Rig, ...]:
        """Return the rig of each sample's newest frame."""
        return tuple(frames[-1] for frames in self.rigs)

    def image_sizes(self) -> tuple[Tensor, Tensor]:
        """Return width and height of every image, (B, T, N) int64 each, px, on the CPU; 0 where there is no camera."""
        cameras = self.images.shape[2]
        sizes = torch.tensor([[_sizes(rig, cameras) for rig in frames] for frames in self.rigs])
        return sizes[..., 0], sizes[..., 1]

    def image_mask(self) -> Bool[Tensor, "B T N H W"]:
        """Return the mask of pixels that are no padding."""
        width, height = (size.to(self.images.device)[..., None, None] for size in self.image_sizes())
        rows, columns = (torch.arange(n, device=self.images.device) for n in self.images.shape[-2:])
        return (rows[:, None] < height) & (columns < width)


def to_device(batch: Batch, device: torch.device) -> Batch:
    """Return a batch with its tensors on a device; rigs and names stay."""
    tensors = {name: item for name, item in batch._asdict().items() if isinstance(item, Tensor)}
    return batch._replace(**{name: item.to(device, non_blocking=True) for name, item in tensors.items()})


class Truth(NamedTuple):
    """The ground truth of one frame, with a batch axis of length 1; fields as in `Batch`."""

    voxels: UInt8[Tensor, "1 X Y Z"]
    lidar_range_m: Float32[Tensor, "1 R"] | None = None
    lidar_labels: UInt8[Tensor, "1 R"] | None = None
    own_voxels: UInt8[Tensor, "1 U V W"] | None = None
    scored: Bool[Tensor, "1 U V W"] | None = None
    ray_origins: Float32[Tensor, "1 O 3"] | None = None
    ray_times: Int64[Tensor, "1 O"] | None = None
    lidar_directions: Float32[Tensor, "1 R 3"] | None = None
    lidar_origins: Float32[Tensor, "1 R 3"] | None = None


def _sizes(rig: Rig, cameras: int) -> list[tuple[int, int]]:
    """Return (width, height) of every camera, padded by (0, 0) to a number of cameras."""
    sizes = [(camera.width, camera.height) for camera in rig.cameras]
    return sizes + [(0, 0)] * (cameras - len(sizes))
