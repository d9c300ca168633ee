"""Rays from the ego origin: of the LiDAR, whose hits score models, and of the panorama of ranges.

Also the rays of the virtual semantic LiDARs, whose points label voxels.
"""

import numpy as np

from omniworld.assets.vehicle import EGO_ROAD_M
from omniworld.render.snapshot import Snapshot

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
    return np.ascontiguousarray(_unit(azimuth.ravel(), elevation.ravel()).T)


def panorama_directions(width: int, height: int, top_deg: float, bottom_deg: float) -> np.ndarray:
    """Return (3, height * width) float32 unit rays of an equirectangular image (see docs/design.md, frames)."""
    azimuth = np.pi - (np.arange(width) + 0.5) * (2 * np.pi / width)
    elevation = np.radians(top_deg - (np.arange(height) + 0.5) * ((top_deg - bottom_deg) / height))
    elevation, azimuth = np.meshgrid(elevation, azimuth, indexing="ij")
    return _unit(azimuth.ravel(), elevation.ravel())


def inner_rays() -> np.ndarray:
    """Return (3, R) float32 rays of the virtual LiDAR at the ego origin, ego frame.

    On flat ground they form a polar grid as fine as the innermost cells of a cylinder; above the road, angles are
    evenly spaced, up to +30 degrees.
    """
    rings = np.concatenate([np.arange(0.05, 4.0, 0.1), np.arange(4.1, 7.0, 0.2)])
    radius_m, azimuth = np.meshgrid(rings, (np.arange(400) + 0.5) * (2 * np.pi / 400), indexing="ij")
    polar = _unit(azimuth.ravel(), np.arctan2(EGO_ROAD_M, radius_m.ravel()))
    return _neighbors_first(np.concatenate([polar, _upper_rays(-EGO_ROAD_M, 8.0)], axis=1))


def outer_rays() -> np.ndarray:
    """Return (3, R) float32 rays of every other virtual LiDAR.

    They are spread by where they land on the road, not by angle: about one for each 0.25 m square within 13 m. Above it
    angles are even, up to +30 degrees.
    """
    height_m, radius_m, count = 3.2, 13.0, 8000
    number = np.arange(count) + 0.5
    distance_m = radius_m * np.sqrt(number / count)
    sunflower = _unit(number * (np.pi * (3 - np.sqrt(5))), np.arctan2(-height_m, distance_m))
    return _neighbors_first(np.concatenate([sunflower, _upper_rays(height_m, radius_m)], axis=1))


def _upper_rays(height_m: float, radius_m: float) -> np.ndarray:
    """Return (3, R) rays at even angles, from those that meet the road at `radius_m` up to +30 degrees.

    Above a slope of 2.6 m in 13 m rays are sparser: only near objects lie inside the grid there.
    """
    rows = [-np.arctan2(height_m, radius_m)]
    while rows[-1] < np.radians(30):
        rows.append(rows[-1] + _step(rows[-1]))
    turn = [np.arange(0, 2 * np.pi, _step(row)) + number * 0.0061 for number, row in enumerate(rows)]
    elevation = np.repeat(rows, [len(azimuth) for azimuth in turn])
    return _unit(np.concatenate(turn), elevation)


def _step(elevation: float) -> float:
    return np.radians(1.2) * max(1.0, np.tan(elevation) * 13 / 2.6)


def _neighbors_first(rays: np.ndarray) -> np.ndarray:
    """Sort rays along Morton's curve, so that neighbours follow one another: Embree is twice as fast on them."""
    azimuth = ((np.arctan2(rays[1], rays[0]) / (2 * np.pi) + 0.5) * 511).astype(np.int64)
    elevation = ((np.arcsin(np.clip(rays[2], -1, 1)) / np.pi + 0.5) * 255).astype(np.int64)
    code = sum((azimuth >> bit & 1) << 2 * bit + 1 | (elevation >> bit & 1) << 2 * bit for bit in range(9))
    return np.ascontiguousarray(rays[:, np.argsort(code, kind="stable")])


def _unit(azimuth: np.ndarray, elevation: np.ndarray) -> np.ndarray:
    """Return (3, R) float32 unit vectors."""
    flat = np.cos(elevation)
    return np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)]).astype(np.float32)


def scan_ego(snapshot: Snapshot, directions_ego: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return range (R,) float32 and class (R,) uint8 along rays (3, R) from the ego origin; inf and 0 without a hit."""
    hits = snapshot.cast(np.zeros(3), directions_ego)
    labels = np.where(hits.face >= 0, snapshot.surfaces.label[hits.face], 0).astype(np.uint8)
    return hits.range_m, labels
