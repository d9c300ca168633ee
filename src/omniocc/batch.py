"""What travels between data, task and model."""

from typing import NamedTuple

from jaxtyping import Bool, Float32, Float64, UInt8
from torch import Tensor

from omniocc.camera import Rig


class Batch(NamedTuple):
    """Windows of T frames, oldest first; all labels belong to the newest frame, in its ego frame.

    Ranges and candidates are there only where a stage asked for them (`omniocc.data.Extras`).

    Attributes:
        images: RGB, 0..255.
        rigs: one per sample.
        world_from_ego: pose of every frame of the window.
        voxels: class of every cell, 255 unknown.
        pixel_labels: class of every pixel; 0 sky, 255 own car or outside the lens.
        lidar_range_m: true range along the ego LiDAR's rays, inf where nothing is hit.
        lidar_labels: true class along these rays, 0 where nothing is hit.
        frame_ids: `scene/frame` of the newest frame, for messages and pictures.
        erp_range_m: true panorama of range around the ego origin, inf for sky.
        camera_range_m: true range of every pixel; inf for sky, nan for own car or outside the lens.
        depth_range_m: panorama that the depth stage predicted, nan where it knows nothing.
        candidates: voxels that the sketch stage chose in every frame of the window.
        exists: which frames of the window were recorded; before a scene's first, that one stands in. None: all.
    """

    images: UInt8[Tensor, "B T N 3 H W"]
    rigs: tuple[Rig, ...]
    world_from_ego: Float64[Tensor, "B T 4 4"]
    voxels: UInt8[Tensor, "B X Y Z"]
    pixel_labels: UInt8[Tensor, "B N H W"]
    lidar_range_m: Float32[Tensor, "B R"]
    lidar_labels: UInt8[Tensor, "B R"]
    frame_ids: tuple[str, ...]
    erp_range_m: Float32[Tensor, "B h w"] | None = None
    camera_range_m: Float32[Tensor, "B N H W"] | None = None
    depth_range_m: Float32[Tensor, "B h w"] | None = None
    candidates: Bool[Tensor, "B T X Y Z"] | None = None
    exists: Bool[Tensor, "B T"] | None = None
