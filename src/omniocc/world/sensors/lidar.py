"""Rays of the ego LiDAR, whose hits score models, and of the virtual semantic LiDARs, whose points label voxels."""

import numpy as np

from omniocc.world.assets.vehicle import EGO_ROAD_M
from omniocc.world.render.snapshot import Snapshot

MAX_RANGE_M = 46.0  # of the virtual LiDARs; beyond it points are too sparse to fill voxels


def ego_directions() -> np.ndarray:
    """Return (14040, 3) float32 unit rays of RayIoU's LiDAR at the ego origin: 39 elevations x 360 azimuths.

    The first ten elevations, -atan(1 / k) for k = 1..10, hit flat ground at equal steps; the others continue
    by atan(10) - atan(9) while below 0.21 rad (SparseOcc, Liu et al. 2024).
    """
    pitch = [-(np.pi / 2 - np.arctan(k)) for k in range(1, 11)]
    while pitch[-1] < 0.21:
        pitch.append(pitch[-1] + np.arctan(10) - np.arctan(9))
    elevation, azimuth = np.meshgrid(pitch, np.radians(np.arange(360)), indexing="ij")
    return _unit(azimuth.ravel(), elevation.ravel())


def inner_rays() -> np.ndarray:
    """Return (3, R) float32 rays of the virtual LiDAR at the ego origin, ego frame.

    On flat ground they form a polar grid as fine as the innermost cells of a cylinder; above it angles are even, up to
    +30 degrees.
    """
    return _neighbors_first(np.concatenate([_polar_rays(), _upper_rays(-EGO_ROAD_M, 8.0, 1.2)], axis=1))


def outer_rays() -> np.ndarray:
    """Return (3, R) float32 rays of every other virtual LiDAR.

    They are spread by where they land on the road, not by angle: about one for each 0.25 m square within 13 m. Above it
    angles are even, up to +30 degrees.
    """
    return _neighbors_first(np.concatenate([_sunflower_rays(3.2, 13.0, 8000), _upper_rays(3.2, 13.0, 1.2)], axis=1))


def _polar_rays() -> np.ndarray:
    rings = np.concatenate([np.arange(0.05, 4.0, 0.1), np.arange(4.1, 7.0, 0.2)])
    radius_m, azimuth = np.meshgrid(rings, (np.arange(400) + 0.5) * (2 * np.pi / 400), indexing="ij")
    return np.ascontiguousarray(_unit(azimuth.ravel(), np.arctan2(EGO_ROAD_M, radius_m.ravel())).T)


def _sunflower_rays(height_m: float, radius_m: float, count: int) -> np.ndarray:
    number = np.arange(count) + 0.5
    distance_m = radius_m * np.sqrt(number / count)
    return np.ascontiguousarray(_unit(number * (np.pi * (3 - np.sqrt(5))), np.arctan2(-height_m, distance_m)).T)


def _upper_rays(height_m: float, radius_m: float, step_deg: float) -> np.ndarray:
    """Return rays at even angles, from where the rays on the road end up to +30 degrees.

    Rays steeper than a rise of 2.6 m over 13 m are sparser, since only near objects are within a grid's height there.
    """
    rows = [-np.arctan2(height_m, radius_m)]
    while rows[-1] < np.radians(30):
        rows.append(rows[-1] + _step(rows[-1], step_deg))
    turn = [np.arange(0, 2 * np.pi, _step(row, step_deg)) + number * 0.0061 for number, row in enumerate(rows)]
    elevation = np.repeat(rows, [len(azimuth) for azimuth in turn])
    return np.ascontiguousarray(_unit(np.concatenate(turn), elevation).T)


def _step(elevation: float, step_deg: float) -> float:
    return np.radians(step_deg) * max(1.0, np.tan(elevation) * 13 / 2.6)


def _neighbors_first(rays: np.ndarray) -> np.ndarray:
    """Sort rays along Morton's curve, so that neighbours follow one another: Embree is twice as fast on them."""
    azimuth = ((np.arctan2(rays[1], rays[0]) / (2 * np.pi) + 0.5) * 511).astype(np.int64)
    elevation = ((np.arcsin(np.clip(rays[2], -1, 1)) / np.pi + 0.5) * 255).astype(np.int64)
    code = sum((azimuth >> bit & 1) << 2 * bit + 1 | (elevation >> bit & 1) << 2 * bit for bit in range(9))
    return np.ascontiguousarray(rays[:, np.argsort(code, kind="stable")])


def _unit(azimuth: np.ndarray, elevation: np.ndarray) -> np.ndarray:
    flat = np.cos(elevation)
    return np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)], axis=1).astype(np.float32)


def scan_ego(snapshot: Snapshot, directions_ego: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return range (R,) float32 and class (R,) uint8 along rays (3, R) from the ego origin; inf and 0 without a hit."""
    hits = snapshot.cast(np.zeros(3), directions_ego)
    labels = np.where(hits.face >= 0, snapshot.surfaces.label[hits.face], 0).astype(np.uint8)
    return hits.range_m, labels
