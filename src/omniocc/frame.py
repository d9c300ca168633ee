"""One recorded frame of the virtual world or of CARLA."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Box:
    """A moving actor's box in the ego frame; `size_m` is along the box's x, y, z, `velocity_mps` is (x, y)."""

    id: int
    label: int
    center_m: tuple[float, float, float]
    size_m: tuple[float, float, float]
    yaw_rad: float
    velocity_mps: tuple[float, float]


@dataclass(frozen=True)
class Frame:
    """One recorded time step; points and boxes are in the ego frame of this time step.

    Attributes:
        time_s: time since the start of the scene.
        world_from_ego: (4, 4) float64 pose of the ego.
        images: (N, H, W, 3) uint8 RGB.
        semantics: (N, H, W) uint8; class ids, 0 sky, 255 ego car or outside the lens.
        range_m: (N, H, W) float32; inf for sky, nan for ego car or outside the lens.
        erp_range_m: (h, w) float32 range from the ego origin over the full turn; inf for sky, without the ego car.
        points_m: (P, 3) float32 surface points, without the ego car.
        point_labels: (P,) uint8 class ids of the points.
        lidar_range_m: (R,) float32 along the ego LiDAR's rays (`omniworld.sensors.lidar.ego_directions`), inf where
            nothing is hit.
        lidar_labels: (R,) uint8 class ids along the same rays; 0 where nothing is hit.
        boxes: moving actors within 80 m.
    """

    time_s: float
    world_from_ego: np.ndarray
    images: np.ndarray
    semantics: np.ndarray
    range_m: np.ndarray
    erp_range_m: np.ndarray
    points_m: np.ndarray
    point_labels: np.ndarray
    lidar_range_m: np.ndarray
    lidar_labels: np.ndarray
    boxes: tuple[Box, ...]
