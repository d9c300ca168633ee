"""One recorded frame as scene folders hold it: a log of a real car lacks parts that the virtual world has."""

from dataclasses import dataclass

import numpy as np

from omniocc.frame import Box


@dataclass(frozen=True)
class RecordedFrame:
    """The attributes of `omniworld.Frame`; those that may be absent are None, in every frame of a scene alike.

    A class of its own, since any change in the code of the virtual world would render all of its data anew.

    Attributes:
        time_s: time since the start of the scene.
        world_from_ego: (4, 4) float64 pose of the ego.
        images: (N, H, W, 3) uint8 RGB.
        semantics: (N, H, W) uint8; class ids, 0 sky, 255 unknown.
        range_m: (N, H, W) float32; inf for sky, nan unknown.
        erp_range_m: (h, w) float32 range from the ego origin over the full turn; inf for sky, nan unknown.
        points_m: (P, 3) float32 surface points, ego frame, without the ego car; absent together with `point_labels`.
        point_labels: (P,) uint8 class ids of the points, 255 unknown.
        lidar_range_m: (R,) float32 along the ego LiDAR's rays (`omniworld.sensors.lidar.ego_directions`), inf where
            nothing is hit; absent together with `lidar_labels`.
        lidar_labels: (R,) uint8 class ids along the same rays; 0 where nothing is hit.
        boxes: moving actors.
    """

    time_s: float
    world_from_ego: np.ndarray
    images: np.ndarray
    semantics: np.ndarray | None = None
    range_m: np.ndarray | None = None
    erp_range_m: np.ndarray | None = None
    points_m: np.ndarray | None = None
    point_labels: np.ndarray | None = None
    lidar_range_m: np.ndarray | None = None
    lidar_labels: np.ndarray | None = None
    boxes: tuple[Box, ...] = ()
