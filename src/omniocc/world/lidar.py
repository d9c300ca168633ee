"""The ego LiDAR, whose rays score models, and the virtual semantic LiDARs around it, whose points label voxels."""

from typing import NamedTuple

import numpy as np

from omniocc.world.caster import Hits
from omniocc.world.stage import Stage

ROAD_M = -2.2  # height of the road under the ego origin
REACH_M = 32.0  # points farther off in x or y are not kept
_COUNT = 20
_SPREAD_M = 20.0
_ROUGH = 89  # one ray of so many in the scans that choose places
_SEEN_AGAIN = 0.25
_FARTHEST_M = 46.0  # of a point from its LiDAR: beyond, points are too sparse to fill voxels
_CUBE_M = 0.1
_NEAR_M = 4.0
_THIN_CLASSES = (9, 10, 11)  # pole, pedestrian, road line


def ego_directions() -> np.ndarray:
    """(14040, 3) float32 unit rays of RayIoU's LiDAR at the ego origin: 39 elevations x 360 azimuths.

    The first ten elevations, -atan(1 / k) for k = 1..10, meet flat ground at equal steps; the others continue
    by atan(10) - atan(9) while below 0.21 rad (SparseOcc, Liu et al. 2024).
    """
    pitch = [-(np.pi / 2 - np.arctan(k)) for k in range(1, 11)]
    while pitch[-1] < 0.21:
        pitch.append(pitch[-1] + np.arctan(10) - np.arctan(9))
    elevation, azimuth = np.meshgrid(pitch, np.radians(np.arange(360)), indexing="ij")
    return _unit(azimuth.ravel(), elevation.ravel())


class Lidars(NamedTuple):
    """The virtual semantic LiDARs, in the ego frame.

    Attributes:
        middle: (3, R) float32 rays of the one at the ego origin.
        outer: (3, R) float32 rays of each of the others.
        spots_m: (K, 3) float32 places where the others may stand.
    """

    middle: np.ndarray
    outer: np.ndarray
    spots_m: np.ndarray


def virtual_lidars() -> Lidars:
    """Rays and possible places of the paper's 20 semantic LiDARs: within 20 m, 1.6 to 4.8 m above the road.

    Rays are dealt by where they land rather than by angle: about one for each 0.2 m square of road within 13 m of each
    LiDAR, and for the one in the middle a polar raster as fine as the innermost cells of a cylinder; above that even
    angles up to +30 degrees.
    """
    across = np.arange(-_SPREAD_M, _SPREAD_M + 1, 4.0)
    x, y = (grid.ravel() for grid in np.meshgrid(across, across, indexing="ij"))
    height_m = 1.6 + 3.2 * ((np.arange(len(x)) * 0.618) % 1)
    spots = np.stack([x, y, ROAD_M + height_m], axis=1).astype(np.float32)
    middle = np.concatenate([_polar_rays(), _upper_rays(-ROAD_M, 8.0)], axis=1)
    outer = np.concatenate([_sunflower_rays(3.2, 13.0, 13000), _upper_rays(3.2, 13.0)], axis=1)
    return Lidars(_neighbors_first(middle), _neighbors_first(outer), spots[np.hypot(x, y) > 3])


def _polar_rays() -> np.ndarray:
    rings = np.concatenate([np.arange(0.05, 4.0, 0.1), np.arange(4.1, 9.0, 0.2)])
    radius_m, azimuth = np.meshgrid(rings, (np.arange(400) + 0.5) * (2 * np.pi / 400), indexing="ij")
    return np.ascontiguousarray(_unit(azimuth.ravel(), np.arctan2(ROAD_M, radius_m.ravel())).T)


def _sunflower_rays(height_m: float, radius_m: float, count: int) -> np.ndarray:
    number = np.arange(count) + 0.5
    distance_m = radius_m * np.sqrt(number / count)
    return np.ascontiguousarray(_unit(number * (np.pi * (3 - np.sqrt(5))), np.arctan2(-height_m, distance_m)).T)


def _upper_rays(height_m: float, radius_m: float) -> np.ndarray:
    """Even angles from where the rays on the road end up to +30 degrees.

    Those steeper than a rise of 2.6 m over 13 m are sparser: only near things lie within a grid's height there.
    """
    rows = [-np.arctan2(height_m, radius_m)]
    while rows[-1] < np.radians(30):
        rows.append(rows[-1] + _step(rows[-1]))
    turn = [np.arange(0, 2 * np.pi, _step(row)) + number * 0.0061 for number, row in enumerate(rows)]
    elevation = np.repeat(rows, [len(azimuth) for azimuth in turn])
    return np.ascontiguousarray(_unit(np.concatenate(turn), elevation).T)


def _step(elevation: float) -> float:
    return np.radians(0.9) * max(1.0, np.tan(elevation) * 13 / 2.6)


def _neighbors_first(rays: np.ndarray) -> np.ndarray:
    """The rays in an order (Morton's) in which neighbours follow one another: Embree is about twice as fast on them."""
    azimuth = ((np.arctan2(rays[1], rays[0]) / (2 * np.pi) + 0.5) * 511).astype(np.int64)
    elevation = ((np.arcsin(np.clip(rays[2], -1, 1)) / np.pi + 0.5) * 255).astype(np.int64)
    code = sum((azimuth >> bit & 1) << 2 * bit + 1 | (elevation >> bit & 1) << 2 * bit for bit in range(9))
    return np.ascontiguousarray(rays[:, np.argsort(code, kind="stable")])


def _unit(azimuth: np.ndarray, elevation: np.ndarray) -> np.ndarray:
    flat = np.cos(elevation)
    return np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)], axis=1).astype(np.float32)


def scan_ego(stage: Stage, directions_ego: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Range (R,) float32 and class (R,) uint8 along rays (3, R) from the ego origin; inf and 0 where nothing is hit."""
    hits = stage.cast(np.zeros(3), directions_ego)
    labels = np.where(hits.face >= 0, stage.surfaces.label[hits.face], 0).astype(np.uint8)
    return hits.range_m, labels


def scan_surfaces(stage: Stage, lidars: Lidars) -> tuple[np.ndarray, np.ndarray]:
    """Points (P, 3) float32 in the ego frame and their classes (P,) uint8, as all virtual LiDARs together see them.

    Beyond 4 m from the ego at most one point is kept in each cube of 0.1 m, a thin thing's before others. Surfaces hit
    from behind (the sensor is inside something) give no points.
    """
    parts = [_scan(stage, np.zeros(3, np.float32), lidars.middle)]
    parts += [_scan(stage, spot, lidars.outer) for spot in choose_spots(stage, lidars)]
    points_m = np.concatenate([points for points, _ in parts])
    labels = np.concatenate([label for _, label in parts])
    keep = _thin_out(points_m, labels)
    return points_m[keep], labels[keep]


def choose_spots(stage: Stage, lidars: Lidars) -> np.ndarray:
    """(19, 3) float32 places of the outer LiDARs at this moment, fewer if fewer are in the open.

    One after the other takes the place from which a sparse scan finds most that the earlier ones miss: blocks of 1.6 m
    count less each time that they are seen again.
    """
    spots = lidars.spots_m[_in_the_open(stage, lidars.spots_m)]
    seen = _rough_scans(stage, spots, lidars.outer[:, ::_ROUGH])
    worth = np.full(seen.shape[1], 256, np.float32)  # whole numbers: sums do not depend on their order
    chosen: list[int] = []
    for _ in range(min(_COUNT - 1, len(spots))):
        gain = seen @ worth
        gain[chosen] = -1
        best = int(np.argmax(gain))
        chosen.append(best)
        worth[seen[best] > 0] = np.floor(worth[seen[best] > 0] * _SEEN_AGAIN)
    return spots[chosen]


def _in_the_open(stage: Stage, spots_m: np.ndarray) -> np.ndarray:
    """(K,) bool: no surface is seen from behind along six axes."""
    probes = np.concatenate([np.eye(3), -np.eye(3)]).astype(np.float32)
    directions = np.tile(probes, (len(spots_m), 1)).T
    hits = _cast_from(stage, spots_m, len(probes), directions)
    inside = _from_behind(stage, hits, stage.turn(directions)).reshape(len(spots_m), len(probes))
    return np.logical_not(inside.any(axis=1))


def _rough_scans(stage: Stage, spots_m: np.ndarray, rays: np.ndarray) -> np.ndarray:
    """(K, blocks) float32: 1 where a few rays from a place meet the block of 1.6 m within 14 m, otherwise 0."""
    count = rays.shape[1]
    directions = np.tile(rays, len(spots_m))
    hits = _cast_from(stage, spots_m, count, directions)
    points = np.repeat(spots_m, count, axis=0) + directions.T * np.minimum(hits.range_m, 1e4)[:, None]
    block = np.floor((points - (0, 0, ROAD_M - 1.2)) / 1.6).astype(np.int64) + np.array([16, 16, 0])
    good = (hits.range_m < 14) & ((block >= 0) & (block < (32, 32, 4))).all(axis=1)
    good &= ~_from_behind(stage, hits, stage.turn(directions)) & (np.hypot(points[:, 0], points[:, 1]) < 26)
    seen = np.zeros((len(spots_m), 32, 32, 4), np.float32)
    seen[(np.repeat(np.arange(len(spots_m)), count)[good], *block[good].T)] = 1
    return seen.reshape(len(spots_m), -1)


def _cast_from(stage: Stage, spots_m: np.ndarray, count: int, directions: np.ndarray) -> Hits:
    """Hits of `count` rays from each place; directions (3, K * count)."""
    origins = np.array([stage.place(spot) for spot in spots_m], np.float32).reshape(-1, 3)
    return stage.layers.cast(np.repeat(origins, count, axis=0), stage.turn(directions).T)


def _scan(stage: Stage, spot: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    count = directions.shape[1]
    nothing = np.zeros(count, np.float32)
    within = Hits(np.full(count, _FARTHEST_M, np.float32), np.full(count, -1, np.int32), nothing, nothing)
    hits = stage.cast(spot, directions, within)
    reach = np.abs(spot[:2, None] + directions[:2] * hits.range_m).max(axis=0) < REACH_M
    index = np.flatnonzero(reach & (hits.face >= 0) & ~_from_behind(stage, hits, stage.turn(directions)))
    points = spot + directions[:, index].T * hits.range_m[index, None]
    return points, stage.surfaces.label[hits.face[index]]


def _from_behind(stage: Stage, hits: Hits, directions: np.ndarray) -> np.ndarray:
    normal = stage.surfaces.table[hits.face, :3]
    facing = normal[:, 0] * directions[0] + normal[:, 1] * directions[1] + normal[:, 2] * directions[2]
    return (hits.face >= 0) & (facing > 0)


def _thin_out(points_m: np.ndarray, labels: np.ndarray) -> np.ndarray:
    """(P,) bool: all points near the ego, and one of each cube farther off."""
    cell = np.floor(points_m / _CUBE_M).astype(np.int64) + 4096
    common = ~np.isin(labels, _THIN_CLASSES)
    cube = ((cell[:, 0] << 13 | cell[:, 1]) << 13 | cell[:, 2]) << 1 | common
    # Number in the low bits: sorted without a separate permutation, and no two keys are equal.
    ordered = np.sort(cube << 23 | np.arange(len(cube)))
    first = np.append(True, np.diff(ordered >> 24) != 0)
    keep = points_m[:, 0] ** 2 + points_m[:, 1] ** 2 < _NEAR_M**2
    keep[ordered[first] & ((1 << 23) - 1)] = True
    return keep
