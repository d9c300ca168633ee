"""Ray patterns of the ego LiDAR, which scores models, and of the virtual semantic LiDARs around it, which label voxels."""

from typing import NamedTuple

import numpy as np

from omniocc.world.caster import Hits
from omniocc.world.stage import Stage

ROAD_M = -2.2  # height of the road under the ego origin
REACH_M = 32.0  # points farther off in x or y are not kept
_COUNT = 20
_SHRINK = (1.0, 0.8, 0.6, 0.4, 0.2)
_CUBE_M = 0.1
_NEAR_M = 4.0
_THIN_CLASSES = (9, 10, 11)  # pole, pedestrian, road line


def ego_directions() -> np.ndarray:
    """(14040, 3) float32 unit rays of RayIoU's LiDAR at the ego origin: 39 elevations, each with azimuths 0, 1, .. 359 degrees.

    The first ten elevations, -atan(1 / k) for k = 1..10, meet flat ground at equal steps; the others continue upwards by atan(10) - atan(9)
    while below 0.21 rad (SparseOcc, Liu et al. 2024).
    """
    pitch = [-(np.pi / 2 - np.arctan(k)) for k in range(1, 11)]
    while pitch[-1] < 0.21:
        pitch.append(pitch[-1] + np.arctan(10) - np.arctan(9))
    elevation, azimuth = np.meshgrid(pitch, np.radians(np.arange(360)), indexing="ij")
    return _unit(azimuth.ravel(), elevation.ravel())


class Pattern(NamedTuple):
    """One virtual LiDAR: candidate positions (K, 3), best first, and directions (3, R), both float32 in the ego frame."""

    positions_m: np.ndarray
    directions: np.ndarray


def virtual_lidars() -> tuple[Pattern, ...]:
    """The 20 semantic LiDARs: one at the ego origin, the others within 20 m and 1.8 to 4.6 m above the road (the paper, Sec. IV).

    Rays are dealt by where they land rather than by angle: about one for each 0.2 m square of road within 13 m of each LiDAR, and for the
    one in the middle a polar raster as fine as the innermost cells of a cylinder; above that even angles up to +30 degrees. Where a LiDAR
    would stand inside something, the next candidate, closer to the ego, is taken.
    """
    middle = Pattern(np.zeros((1, 3), np.float32), np.concatenate([_polar_rays(), _upper_rays(-ROAD_M, 8.0)], axis=1))
    return (middle, *(_outer(index) for index in range(1, _COUNT)))


def _outer(index: int) -> Pattern:
    """Six on an inner ring, thirteen on an outer one."""
    inner = index <= 6
    turn = index / 6 if inner else (index - 7) / 13 + 0.02
    distance_m = 9.0 if inner else 18.5
    height_m = 1.8 + 2.8 * ((index * 0.618) % 1)
    place = np.array([distance_m * np.cos(2 * np.pi * turn), distance_m * np.sin(2 * np.pi * turn)])
    spots = [(*(place * shrink), ROAD_M + height_m) for shrink in _SHRINK]
    rays = np.concatenate([_sunflower_rays(height_m, 13.0, 13000), _upper_rays(height_m, 13.0)], axis=1)
    return Pattern(np.array(spots, np.float32), rays)


def _polar_rays() -> np.ndarray:
    radius_m, azimuth = np.meshgrid(np.arange(0.05, 8.0, 0.1), (np.arange(400) + 0.5) * (2 * np.pi / 400), indexing="ij")
    return np.ascontiguousarray(_unit(azimuth.ravel(), np.arctan2(ROAD_M, radius_m.ravel())).T)


def _sunflower_rays(height_m: float, radius_m: float, count: int) -> np.ndarray:
    number = np.arange(count) + 0.5
    distance_m = radius_m * np.sqrt(number / count)
    return np.ascontiguousarray(_unit(number * (np.pi * (3 - np.sqrt(5))), np.arctan2(-height_m, distance_m)).T)


def _upper_rays(height_m: float, radius_m: float) -> np.ndarray:
    step = np.radians(0.9)
    bottom = -np.arctan2(height_m, radius_m)
    azimuth, elevation = np.meshgrid(np.arange(400) * (2 * np.pi / 400), np.arange(bottom, np.radians(30), step), indexing="xy")
    row = np.arange(azimuth.shape[0])[:, None]
    return np.ascontiguousarray(_unit((azimuth + row * 0.0061).ravel(), elevation.ravel()).T)


def _unit(azimuth: np.ndarray, elevation: np.ndarray) -> np.ndarray:
    flat = np.cos(elevation)
    return np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)], axis=1).astype(np.float32)


def scan_ego(stage: Stage, directions_ego: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Range (R,) float32 and class (R,) uint8 along rays (3, R) from the ego origin; inf and 0 where nothing is hit."""
    hits = stage.cast(np.zeros(3), directions_ego)
    labels = np.where(hits.face >= 0, stage.surfaces.label[hits.face], 0).astype(np.uint8)
    return hits.range_m, labels


def scan_surfaces(stage: Stage, patterns: tuple[Pattern, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Points (P, 3) float32 in the ego frame and their classes (P,) uint8, as all virtual LiDARs together see them.

    Beyond 4 m from the ego at most one point is kept in each cube of 0.1 m, a thin thing's before others. Surfaces hit from behind (the
    sensor is inside something) give no points.
    """
    spots = choose_positions(stage, patterns)
    parts = [_scan(stage, spot, pattern.directions) for spot, pattern in zip(spots, patterns, strict=True) if spot is not None]
    points_m = np.concatenate([points for points, _ in parts])
    labels = np.concatenate([label for _, label in parts])
    keep = _thin_out(points_m, labels)
    return points_m[keep], labels[keep]


def choose_positions(stage: Stage, patterns: tuple[Pattern, ...]) -> list[np.ndarray | None]:
    """For each LiDAR the first candidate (3,) in the open, None if all are inside something."""
    candidates = np.concatenate([pattern.positions_m for pattern in patterns])
    probes = np.concatenate([np.eye(3), -np.eye(3)]).astype(np.float32)
    turned = stage.turn(probes.T).T
    origins = np.stack([stage.place(spot) for spot in candidates])
    hits = stage.layers.cast(np.repeat(origins, len(probes), axis=0), np.tile(turned, (len(candidates), 1)))
    inside = _from_behind(stage, hits, np.tile(turned.T, len(candidates)))
    free = ~inside.reshape(len(candidates), len(probes)).any(axis=1)
    result: list[np.ndarray | None] = []
    start = 0
    for pattern in patterns:
        index = np.flatnonzero(free[start : start + len(pattern.positions_m)])
        result.append(pattern.positions_m[index[0]] if len(index) else None)
        start += len(pattern.positions_m)
    return result


def _scan(stage: Stage, spot: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    hits = stage.cast(spot, directions)
    reach = np.abs(spot[:2, None] + directions[:2] * np.minimum(hits.range_m, 1e4)).max(axis=0) < REACH_M
    index = np.flatnonzero(reach & (hits.face >= 0) & ~_from_behind(stage, hits, stage.turn(directions)))
    points = spot + directions[:, index].T * hits.range_m[index, None]
    return points, stage.surfaces.label[hits.face[index]]


def _from_behind(stage: Stage, hits: Hits, directions: np.ndarray) -> np.ndarray:
    normal = stage.surfaces.table[hits.face, :3]
    facing = normal[:, 0] * directions[0] + normal[:, 1] * directions[1] + normal[:, 2] * directions[2]
    return (hits.face >= 0) & (facing > 0)


def _thin_out(points_m: np.ndarray, labels: np.ndarray) -> np.ndarray:
    """(P,) bool: all points near the ego, and one of each cube farther off."""
    cell = np.floor(points_m / _CUBE_M).astype(np.int32)
    side, height = round(2 * REACH_M / _CUBE_M), 128
    flat = ((cell[:, 0] + side // 2) * side + cell[:, 1] + side // 2) * height + np.mod(cell[:, 2], height)
    order = np.arange(len(flat), dtype=np.int32)
    winner = np.empty(side * side * height, np.int32)
    thin = np.isin(labels, _THIN_CLASSES)
    # Later writes win: thin things last.
    winner[flat[~thin]] = order[~thin]
    winner[flat[thin]] = order[thin]
    near = points_m[:, 0] ** 2 + points_m[:, 1] ** 2 < _NEAR_M**2
    return near | (winner[flat] == order)
