"""Ray casting with Embree: the nearest hit, and whether anything blocks a ray."""

import ctypes
from typing import NamedTuple

import numpy as np

from omniworld.mesh.mesh import Mesh
from omniworld.render.embree import ARGUMENTS, Triangles, intersect, occlude

_ARGUMENTS = ctypes.addressof(ARGUMENTS)
_NO_LIMIT = np.full(1, np.inf, np.float32)


class Hits(NamedTuple):
    """Nearest hits of R rays.

    Attributes:
        range_m: (R,) float32 along unit directions, inf where nothing is hit.
        face: (R,) int32 triangle, -1 where nothing is hit.
        u: (R,) float32 barycentric weight of the triangle's second corner.
        v: (R,) float32 barycentric weight of the third corner.
    """

    range_m: np.ndarray
    face: np.ndarray
    u: np.ndarray
    v: np.ndarray

    def take(self, index: np.ndarray) -> "Hits":
        """Return the hits of some of the rays."""
        return Hits(*(array.take(index) for array in self))


class Caster:
    """An immutable set of triangles, perhaps empty; rays are given in the mesh's frame.

    Rays are cast in packets of eight, so neighbours in the arrays should be neighbours in space.
    """

    def __init__(self, mesh: Mesh) -> None:
        self.size = len(mesh)
        self._scene = None
        if self.size:
            vertices = np.ascontiguousarray(mesh.vertices, dtype=np.float32)
            self._scene = Triangles(vertices, np.ascontiguousarray(mesh.faces, dtype=np.int32))

    def cast(self, origins: np.ndarray, directions: np.ndarray, limit_m: np.ndarray | None = None) -> Hits:
        """Return the nearest hit of each ray.

        Args:
            origins: (R, 3) float32, or (1, 3) shared by all rays.
            directions: (R, 3) float32 unit vectors.
            limit_m: (R,) float32 range from which on hits count as misses.
        """
        count = len(directions)
        if self._scene is None or count == 0:
            return no_hits(count)
        limits = _NO_LIMIT if limit_m is None else limit_m
        hits = Hits(*(np.empty(count, kind) for kind in (np.float32, np.int32, np.float32, np.float32)))
        intersect(self._scene.pointer, _ARGUMENTS, _by_axis(origins), _by_axis(directions), limits, *hits)
        return hits

    def blocked(self, origins: np.ndarray, directions: np.ndarray, limit_m: float = np.inf) -> np.ndarray:
        """Return (R,) bool: whether an object is along each ray before `limit_m`.

        `directions` is (R, 3), or (1, 3) shared by all rays.
        """
        result = np.zeros(len(origins), dtype=bool)
        if self._scene is not None and len(origins):
            limits = np.full(1, limit_m, np.float32)
            occlude(self._scene.pointer, _ARGUMENTS, _by_axis(origins), _by_axis(directions), limits, result)
        return result


class Layers:
    """Several casters as one: faces are numbered layer by layer; of equally near hits the first layer's counts."""

    def __init__(self, casters: list[Caster]) -> None:
        self.casters = casters
        self.offsets = np.cumsum([0] + [caster.size for caster in casters])

    def cast(self, origins: np.ndarray, directions: np.ndarray, known: Hits | None = None) -> Hits:
        """Return the nearest hit over all layers and the hits in `known`, whose face numbers are kept."""
        best = known
        for caster, offset in zip(self.casters, self.offsets, strict=False):
            if caster.size == 0 and best is not None:
                continue
            found = caster.cast(origins, directions, None if best is None else best.range_m)
            best = found if best is None else _nearer(best, found, int(offset))
        assert best is not None, "a world without layers"
        return best

    def blocked(self, origins: np.ndarray, directions: np.ndarray, limit_m: float = np.inf) -> np.ndarray:
        """Return (R,) bool: whether an object of any layer is along each ray before `limit_m`."""
        result = np.zeros(len(origins), dtype=bool)
        for caster in self.casters:
            if caster.size:
                free = np.flatnonzero(~result)
                toward = directions if len(directions) == 1 else directions[free]
                result[free] = caster.blocked(origins[free], toward, limit_m)
        return result


def _by_axis(rays: np.ndarray) -> np.ndarray:
    """Return (R, 3) as contiguous (3, R) float32."""
    return np.ascontiguousarray(rays.T, np.float32)


def no_hits(count: int, range_m: float = np.inf) -> Hits:
    """Return hits of rays that hit nothing before `range_m`."""
    zeros = np.zeros(count, np.float32)
    return Hits(np.full(count, range_m, np.float32), np.full(count, -1, np.int32), zeros, zeros)


def _nearer(best: Hits, found: Hits, offset: int) -> Hits:
    """Return `found` where it hit (its rays ended at `best`), elsewhere `best`."""
    missed = found.face < 0
    if missed.all():
        return best
    found.face[:] += np.int32(offset)
    for mine, other in zip(found, best, strict=True):
        np.copyto(mine, other, where=missed)
    return found
