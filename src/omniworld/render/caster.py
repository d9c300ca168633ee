"""Ray casting with Embree: the nearest hit, and whether anything blocks a ray.

Rays are cast in packets of eight neighbours: twice as fast as ray by ray, with the same hits. The package embreex
brings Embree's library; its own interface casts rays one by one, so the few functions needed here are called through
ctypes and, in loops over rays, from compiled code. API: https://www.embree.org/api.html
"""

import ctypes
import platform
import weakref
from ctypes import c_char_p, c_int, c_size_t, c_uint, c_void_p
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple, no_type_check

import llvmlite.binding
import numpy as np
from numba.core import types

from omniworld.mesh.mesh import Mesh
from rayiou.compiled import compiled

WIDTH = 8
_RAY, _HIT = 12 * WIDTH, 9 * WIDTH  # numbers in RTCRay8 and RTCHit8
_TRIANGLES, _FLOAT3, _UINT3, _VERTICES, _INDICES = 0, 0x9003, 0x5003, 1, 0  # RTCGeometryType, RTCFormat, RTCBufferType
_COHERENT = 1 << 16  # RTC_RAY_QUERY_FLAG_COHERENT
_NO_LIMIT = np.full(1, np.inf, np.float32)
_PROTOTYPES: dict[str, tuple[list[type], type | None]] = {
    "rtcNewDevice": ([c_char_p], c_void_p),
    "rtcNewScene": ([c_void_p], c_void_p),
    "rtcNewGeometry": ([c_void_p, c_int], c_void_p),
    "rtcSetNewGeometryBuffer": ([c_void_p, c_int, c_uint, c_int, c_size_t, c_size_t], c_void_p),
    "rtcCommitGeometry": ([c_void_p], None),
    "rtcAttachGeometry": ([c_void_p, c_void_p], c_uint),
    "rtcReleaseGeometry": ([c_void_p], None),
    "rtcCommitScene": ([c_void_p], None),
    "rtcReleaseScene": ([c_void_p], None),
}
_FOUR_POINTERS = types.void(types.intp, types.intp, types.intp, types.intp)
_intersect8 = types.ExternalFunction("rtcIntersect8", _FOUR_POINTERS)
_occluded8 = types.ExternalFunction("rtcOccluded8", _FOUR_POINTERS)


class _Arguments(ctypes.Structure):
    """RTCIntersectArguments and RTCOccludedArguments, which begin alike."""

    _fields_ = (
        ("flags", c_int),
        ("feature_mask", c_uint),
        ("context", c_void_p),
        ("filter", c_void_p),
        ("function", c_void_p),
        ("width_factor", ctypes.c_float),
    )


ARGUMENTS = _Arguments(flags=_COHERENT, feature_mask=0xFFFFFFFF)
_ARGUMENTS = ctypes.addressof(ARGUMENTS)


@lru_cache(maxsize=1)
def library() -> tuple[ctypes.CDLL, int]:
    """Return Embree's library and a device of it; raise ImportError if it is not installed."""
    try:
        import embreex

        (path,) = (Path(embreex.__file__).parents[1] / "embreex.libs").glob("libembree4*")
    except (ImportError, ValueError) as error:
        raise ImportError(
            f"rendering the virtual world needs the package 'embreex', which is not installed or has no wheel for this "
            f"platform ({platform.system()} {platform.machine()}, Python {platform.python_version()}); install it with "
            "`pip install embreex` on an x86-64 machine, or use a dataset rendered on another machine"
        ) from error
    found = ctypes.CDLL(str(path))
    for name, (arguments, result) in _PROTOTYPES.items():
        function = getattr(found, name)
        function.argtypes, function.restype = arguments, result
    llvmlite.binding.load_library_permanently(str(path))  # compiled code finds its functions by name
    return found, found.rtcNewDevice(b"threads=1")


class Triangles:
    """A scene of Embree: triangles `faces` (F, 3) int32 between `vertices` (V, 3) float32."""

    def __init__(self, vertices: np.ndarray, faces: np.ndarray) -> None:
        embree, device = library()
        geometry = embree.rtcNewGeometry(device, _TRIANGLES)
        for kind, form, array in ((_VERTICES, _FLOAT3, vertices), (_INDICES, _UINT3, faces)):
            buffer = embree.rtcSetNewGeometryBuffer(geometry, kind, 0, form, 12, len(array))
            ctypes.memmove(buffer, array.ctypes.data, array.nbytes)
        embree.rtcCommitGeometry(geometry)
        self.pointer = embree.rtcNewScene(device)
        embree.rtcAttachGeometry(self.pointer, geometry)
        embree.rtcReleaseGeometry(geometry)
        embree.rtcCommitScene(self.pointer)
        weakref.finalize(self, embree.rtcReleaseScene, self.pointer)


@compiled
@no_type_check
def _packet():
    """Return memory for RTCRayHit8, as float32 and as int32, and for which rays are valid: at multiples of 32 bytes."""
    memory = np.empty(_RAY + _HIT + 3 * WIDTH, np.float32)
    first = (-memory.ctypes.data // 4) % WIDTH
    aligned = memory[first : first + _RAY + _HIT + WIDTH]
    packet, valid = aligned[:-WIDTH], aligned[-WIDTH:].view(np.int32)
    return packet, packet.view(np.int32), valid


@compiled
@no_type_check
def _fill(packet, whole, valid, start, origins, directions, limit_m):
    """Write eight rays, from number `start` on, into a packet; those beyond the last are not valid.

    `whole` is the packet seen as int32.
    """
    count = max(origins.shape[1], directions.shape[1])
    for place in range(WIDTH):
        ray = min(start + place, count - 1)
        valid[place] = -1 if start + place < count else 0
        origin, direction = min(ray, origins.shape[1] - 1), min(ray, directions.shape[1] - 1)
        for axis in range(3):
            packet[axis * WIDTH + place] = origins[axis, origin]
            packet[(4 + axis) * WIDTH + place] = directions[axis, direction]
        packet[3 * WIDTH + place] = packet[7 * WIDTH + place] = 0  # start of the ray, time
        packet[8 * WIDTH + place] = limit_m[min(ray, len(limit_m) - 1)]
        whole[9 * WIDTH + place], whole[11 * WIDTH + place] = -1, 0  # mask, flags
        whole[_RAY + 6 * WIDTH + place] = whole[_RAY + 7 * WIDTH + place] = -1  # geometry, instance


@compiled
@no_type_check
def intersect(scene, arguments, origins, directions, limit_m, range_m, face, u, v):
    """Fill range, face and barycentric weights of R rays; inf, -1 and 0 where nothing is hit before `limit_m`.

    `scene` and `arguments` are pointers. `origins` and `directions` are (3, R) float32, or (3, 1) if equal for all
    rays; `limit_m` is (R,), or (1,) if equal for all.
    """
    packet, whole, valid = _packet()
    for start in range(0, len(face), WIDTH):
        _fill(packet, whole, valid, start, origins, directions, limit_m=limit_m)
        _intersect8(valid.ctypes.data, scene, packet.ctypes.data, arguments)
        for place in range(min(WIDTH, len(face) - start)):
            ray = start + place
            hit = whole[_RAY + 6 * WIDTH + place] != -1
            face[ray] = whole[_RAY + 5 * WIDTH + place] if hit else -1
            range_m[ray] = packet[8 * WIDTH + place] if hit else np.inf
            u[ray] = packet[_RAY + 3 * WIDTH + place] if hit else 0
            v[ray] = packet[_RAY + 4 * WIDTH + place] if hit else 0


@compiled
@no_type_check
def occlude(scene, arguments, origins, directions, limit_m, blocked):
    """Fill whether anything is hit before `limit_m`; arguments as for `intersect`."""
    packet, whole, valid = _packet()
    for start in range(0, len(blocked), WIDTH):
        _fill(packet, whole, valid, start, origins, directions, limit_m=limit_m)
        _occluded8(valid.ctypes.data, scene, packet.ctypes.data, arguments)
        for place in range(min(WIDTH, len(blocked) - start)):
            blocked[start + place] = packet[8 * WIDTH + place] < 0


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
