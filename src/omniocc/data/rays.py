"""Measured rays of a frame and of the frames around it, in the frame's ego frame, without what has moved."""

import numpy as np
import torch
from jaxtyping import Bool, Float32, Float64

from omniocc.classes import FREE, UNKNOWN
from omniocc.data.formats.poses import inverse, transform_points
from omniocc.data.source import LidarScan, SceneFrames, has_poses
from omniocc.errors import UserError
from omniocc.loss import Rays, RayWindow

FAR_M = 1000.0
"""Length of rays that hit nothing, m."""
BINS = (180, 360)
"""Directions of 1 degree in which two scans are compared: elevations and azimuths."""
MOVED_M = 1.0
"""Distance by which a point of another frame lies before everything measured around its direction if it has moved."""


def scan_of(scene: SceneFrames, frame: int) -> LidarScan | None:
    """Return what the LiDAR measured, also where a scene has scans without classes; None without scans."""
    return getattr(scene, "scan", scene.lidar)(frame)


def rays_around(scene: SceneFrames, frame: int, window: RayWindow) -> Rays | None:
    """Return the rays of a frame and its neighbours, (1, R), in the frame's ego frame; None if the frame has no scan.

    Points of neighbours that moved are left out with their rays: by the boxes of actors where the scene has them, else
    those that lie in space that the frame's own scan saw as free (`in_front`).

    Raises:
        DataError: naming the frame that is damaged.
        UserError: if neighbours are asked for, but the scene has no poses.
    """
    own = scan_of(scene, frame)
    if own is None:
        return None
    if any(window.frames) and not has_poses(scene):
        given = f"loss.rays.frames={list(window.frames)}"
        raise UserError(f"{given}: '{scene.name}' has no poses for rays of other frames; choose loss.rays.frames=[0]")
    parts = [_rays(own)]
    ego_from_world = inverse(scene.world_from_ego[frame])
    for other in (frame + step for step in window.frames if step):
        scan = scan_of(scene, other) if 0 <= other < len(scene) else None
        if scan is None:
            continue
        pose = ego_from_world @ scene.world_from_ego[other]
        origins_m, ends_m, labels = _rays(scan if scan.moving is None else _of(scan, ~scan.moving))
        origins_m, ends_m = (transform_points(pose, points).astype(np.float32) for points in (origins_m, ends_m))
        stays = np.ones(len(labels), bool)
        if scan.moving is None:
            stays = (labels == FREE) | ~in_front(ends_m, own)
        parts.append((origins_m[stays], ends_m[stays], labels[stays]))
    origins_m, ends_m, labels = (torch.from_numpy(np.concatenate(column))[None] for column in zip(*parts, strict=True))
    rays = Rays(origins_m, ends_m, labels)
    return rays if window.classes else rays.without_classes()


def _of(scan: LidarScan, chosen: Bool[np.ndarray, " R"]) -> LidarScan:
    return LidarScan(*(None if part is None else part[chosen] for part in scan))  # type: ignore[arg-type]


def _rays(scan: LidarScan) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return origins, ends and labels of the rays that measured something: a hit, or nothing as far as they reach."""
    nothing = (scan.labels == FREE) | np.isinf(scan.range_m)
    known = (scan.range_m > 0) & ~(np.isinf(scan.range_m) & (scan.labels == UNKNOWN))
    labels = np.where(nothing, FREE, scan.labels).astype(np.uint8)
    origins_m = np.zeros_like(scan.directions) if scan.origins is None else scan.origins
    ends_m = origins_m + np.where(nothing, FAR_M, scan.range_m)[:, None] * scan.directions
    return origins_m[known].astype(np.float32), ends_m[known].astype(np.float32), labels[known]


def in_front(points_m: Float32[np.ndarray, "P 3"], scan: LidarScan) -> Bool[np.ndarray, " P"]:
    """Return which points lie at least `MOVED_M` before everything that a scan measured within about 1.5 degrees.

    The rays of the scan are taken to start in their mean origin. Points in directions without rays are not in front.
    """
    origins_m, ends_m, _ = _rays(scan)
    if not len(ends_m):
        return np.zeros(len(points_m), bool)
    middle_m = origins_m.mean(0)
    nearest_m = np.full(BINS, np.inf)
    seen = np.zeros(BINS, bool)
    bins, range_m = _bins(ends_m - middle_m)
    np.minimum.at(nearest_m, bins, range_m)
    seen[bins] = True
    nearest_m, seen = np.min(_neighbours(nearest_m), 0), np.any(_neighbours(seen), 0)
    bins, range_m = _bins(points_m - middle_m)
    return seen[bins] & (range_m + MOVED_M < nearest_m[bins])


def _neighbours(image: np.ndarray) -> list[np.ndarray]:
    """Return an image of all directions and its shifts to the eight neighbours of every bin."""
    rows = np.pad(image, ((1, 1), (0, 0)), mode="edge")
    return [np.roll(rows[row : row + len(image)], turn, 1) for row in range(3) for turn in (-1, 0, 1)]


def _bins(ways_m: Float32[np.ndarray, "P 3"]) -> tuple[tuple[np.ndarray, np.ndarray], Float64[np.ndarray, " P"]]:
    """Return row and column of each direction, and the distance, m."""
    x, y, z = ways_m.astype(np.float64).T
    turn = (np.arctan2(y, x) / (2 * np.pi) + 0.5) * BINS[1]
    height = (np.arctan2(z, np.hypot(x, y)) / np.pi + 0.5) * BINS[0]
    bins = (part.astype(np.int64).clip(0, most - 1) for part, most in zip((height, turn), BINS, strict=True))
    return tuple(bins), np.sqrt(x**2 + y**2 + z**2)  # type: ignore[return-value]
