"""The virtual semantic LiDARs, whose points label voxels.

One moves with the ego. The others stand still on a lattice in the world, and those nearest to the ego are active. Their
view of static objects is cast once and kept while they are near: a frame costs little more than the moving objects.
"""

from collections import OrderedDict
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from omniworld.render.caster import Caster, Hits, no_hits
from omniworld.render.cull import make_cones, may_hit
from omniworld.render.snapshot import Snapshot
from omniworld.render.surface import Surfaces
from omniworld.sensors.lidar import MAX_RANGE_M, inner_rays, outer_rays
from omniworld.sensors.thinning import SCRATCH, cubes, first_of_each, within_reach

LATTICE_M = 6.0
_SPREAD_M = 21.0  # greatest distance from the ego to an active LiDAR
_TRIES = 4  # positions tried in a square of the lattice before it stays empty
_KEPT = 48  # sweeps
_BUNDLE = 64  # rays in a cone
_NOTHING = np.empty((0, 3), np.float32), np.empty(0, np.uint8), np.empty(0, np.int32)
_PROBES = np.concatenate([np.eye(3), -np.eye(3)]).astype(np.float32)

Height = Callable[[np.ndarray, np.ndarray], np.ndarray]


class Sweep(NamedTuple):
    """The static surfaces that one standing LiDAR sees, in the world frame.

    Attributes:
        position_m: (3,) float32 of the LiDAR.
        range_m: (R,) float32 of all rays, `MAX_RANGE_M` where nothing is hit.
        ray: (K,) int32 rays that hit a surface from its front.
        points_m: (K, 3) float32.
        labels: (K,) uint8.
        cube: (K,) int32, number of each point's cube, see `thinning.cubes`.
    """

    position_m: np.ndarray
    range_m: np.ndarray
    ray: np.ndarray
    points_m: np.ndarray
    labels: np.ndarray
    cube: np.ndarray


class SemanticLidars:
    """The virtual LiDARs of a scene, `count` with the ego's.

    `surfaces` are the tables of the static faces, `height` gives the ground's height (m) at world x and y.
    """

    def __init__(self, static: Caster, surfaces: Surfaces, height: Height, count: int = 20) -> None:
        self._static = static
        self._surfaces = surfaces
        self._height = height
        self._count = count
        self._inner = inner_rays()
        self._outer = np.ascontiguousarray(outer_rays().T)
        self._cones = make_cones(self._outer.T, np.arange(len(self._outer)) // _BUNDLE)
        self._scratch = np.zeros(SCRATCH, np.int32)
        self._positions: dict[tuple[int, int], np.ndarray | None] = {}
        self._sweeps: OrderedDict[tuple[int, int], Sweep] = OrderedDict()

    def scan(self, snapshot: Snapshot) -> tuple[np.ndarray, np.ndarray]:
        """Return points (P, 3) float32 in the ego frame and their classes (P,) uint8, as all LiDARs see them.

        All points of the ego's LiDAR are kept, and of the others about one in each cube of 0.1 m, thin objects first.
        Surfaces hit from behind (the LiDAR is inside an object) give no points.
        """
        ego_points_m, ego_labels = self._scan_from_ego(snapshot)
        parts = [self._scan_from(snapshot, self._sweep(cell)) for cell in self.cells(snapshot.origin_m)]
        points_m, labels, cube = (
            np.concatenate([empty, *(part[k] for part in parts)]) for k, empty in enumerate(_NOTHING)
        )
        keep = first_of_each(cube, labels, self._scratch)
        points_m = snapshot.ego_points(np.concatenate([ego_points_m, points_m[keep]]))
        labels = np.concatenate([ego_labels, labels[keep]])
        near = np.flatnonzero(within_reach(points_m))
        return points_m[near], labels[near]

    def cells(self, ego_m: np.ndarray) -> list[tuple[int, int]]:
        """Return the lattice squares of the LiDARs that are active when the ego is at (3,), nearest first."""
        column, row = (int(np.floor(value / LATTICE_M)) for value in ego_m[:2])
        reach = int(np.ceil(_SPREAD_M / LATTICE_M))
        around = range(-reach, reach + 1)
        found = []
        for cell in ((column + a, row + b) for a in around for b in around):
            position = self.position(cell)
            if position is not None:
                found.append((float(np.hypot(*(position[:2] - ego_m[:2]))), cell))
        return [cell for distance, cell in sorted(found) if distance < _SPREAD_M][: self._count - 1]

    def position(self, cell: tuple[int, int]) -> np.ndarray | None:
        """Return the position (3,) of a square's LiDAR, 1.6 to 4.8 m above the ground; None without open space."""
        if cell not in self._positions:
            draws = np.random.default_rng([cell[0] & 0xFFFF, cell[1] & 0xFFFF, 23]).random((_TRIES, 3))
            x, y = ((np.array(cell) + 0.15 + 0.7 * draws[:, :2]) * LATTICE_M).T
            tries = np.stack([x, y, self._height(x, y) + 1.6 + 3.2 * draws[:, 2]], axis=1).astype(np.float32)
            good = np.flatnonzero(self._in_the_open(tries))
            self._positions[cell] = tries[good[0]] if len(good) else None
        return self._positions[cell]

    def _in_the_open(self, positions_m: np.ndarray) -> np.ndarray:
        """Return (K,) bool: whether no surface is seen from behind or within 0.5 m along six axes."""
        directions = np.tile(_PROBES, (len(positions_m), 1))
        hits = self._static.cast(np.repeat(positions_m, len(_PROBES), axis=0), directions)
        facing = (self._surfaces.table[hits.face, :3] * directions).sum(axis=1)
        bad = (hits.face >= 0) & (facing > 0) | (hits.range_m < 0.5)
        return np.logical_not(bad.reshape(-1, len(_PROBES)).any(axis=1))

    def _sweep(self, cell: tuple[int, int]) -> Sweep:
        if cell in self._sweeps:
            self._sweeps.move_to_end(cell)
            return self._sweeps[cell]
        position = self.position(cell)
        assert position is not None, "this square of the lattice has no LiDAR"
        hits = self._static.cast(position[None], self._outer, np.full(len(self._outer), MAX_RANGE_M, np.float32))
        range_m = np.minimum(hits.range_m, np.float32(MAX_RANGE_M))
        ray, points, labels = _points(self._surfaces, hits, position, self._outer)
        cube = cubes(points)
        keep = first_of_each(cube, labels, self._scratch)
        sweep = Sweep(position, range_m, ray[keep], points[keep], labels[keep], cube[keep])
        self._sweeps[cell] = sweep
        if len(self._sweeps) > _KEPT:
            self._sweeps.popitem(last=False)
        return sweep

    def _scan_from(self, snapshot: Snapshot, sweep: Sweep) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return points, classes and cubes of a sweep, with moving things in front of the static ones."""
        offset, moving = int(snapshot.layers.offsets[1]), snapshot.layers.casters[1]
        maybe = np.flatnonzero(may_hit(self._cones, sweep.position_m, snapshot.spheres)[self._cones.bundle])
        found = moving.cast(sweep.position_m[None], self._outer[maybe], sweep.range_m[maybe])
        reached = np.flatnonzero(found.face >= 0)
        if len(reached) == 0:
            return sweep.points_m, sweep.labels, sweep.cube
        ray, some = maybe[reached], found.take(reached)
        hit = np.zeros(len(self._outer), dtype=bool)
        hit[ray] = True
        some.face[:] += np.int32(offset)
        _, points, labels = _points(snapshot.surfaces, some, sweep.position_m, self._outer[ray])
        stay = np.flatnonzero(~hit[sweep.ray])
        return (
            np.concatenate([sweep.points_m[stay], points]),
            np.concatenate([sweep.labels[stay], labels]),
            np.concatenate([sweep.cube[stay], cubes(points)]),
        )

    def _scan_from_ego(self, snapshot: Snapshot) -> tuple[np.ndarray, np.ndarray]:
        """Return points and classes seen by the LiDAR at the ego origin, static and moving."""
        directions = np.ascontiguousarray(snapshot.world_directions(self._inner).T)
        position, count = snapshot.world_point(np.zeros(3)), len(directions)
        hits = snapshot.layers.cast(position[None], directions, no_hits(count, MAX_RANGE_M))
        _, points, labels = _points(snapshot.surfaces, hits, position, directions)
        return points, labels


def _points(
    surfaces: Surfaces, hits: Hits, position_m: np.ndarray, directions: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return ray number, point and class of every hit from the front."""
    hit = np.flatnonzero(hits.face >= 0).astype(np.int32)
    toward, normal = directions[hit], surfaces.table[hits.face[hit], :3]
    ray = hit[np.einsum("ij,ij->i", normal, toward) <= 0]
    points = position_m + directions[ray] * hits.range_m[ray, None]
    return ray, points, surfaces.label[hits.face[ray]]
