"""Culling: which rays may hit a moving object; most cannot, and this test is cheaper than casting them."""

from typing import NamedTuple

import numpy as np

from omniworld.mesh.mesh import Mesh

_CELL_M = 0.5
_SIDE = 256  # cells; the shadow mask repeats after 128 m


class Cones(NamedTuple):
    """Bundles of neighbouring rays from one point.

    Attributes:
        axis: (B, 3) float32 unit vectors.
        half_rad: (B,) float32 largest angle between a bundle's rays and its axis.
        bundle: (R,) int32 bundle of each ray.
    """

    axis: np.ndarray
    half_rad: np.ndarray
    bundle: np.ndarray


def make_cones(directions: np.ndarray, bundle: np.ndarray) -> Cones:
    """Build cones around unit directions (3, R) with the bundle (R,) of each, numbered from 0 without gaps."""
    total = np.stack([np.bincount(bundle, weights=row) for row in directions], axis=1)
    axis = total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-9)
    least = np.ones(len(axis))
    np.minimum.at(least, bundle, np.einsum("ir,ri->r", directions, axis[bundle]))
    # unit vectors in float32 are up to 5e-8 too long or short, which moves an arc cosine near 1 by up to 3e-4
    half_rad = np.arccos(np.clip(least, -1, 1)) + 1e-3
    return Cones(axis.astype(np.float32), half_rad.astype(np.float32), bundle.astype(np.int32))


def may_hit(cones: Cones, point_m: np.ndarray, spheres: np.ndarray) -> np.ndarray:
    """Return (B,) bool: whether rays of a bundle from a point (3,) may hit a sphere of (K, 4), centre and radius."""
    offset = spheres[:, :3] - point_m
    distance = np.linalg.norm(offset, axis=1)
    if (distance <= spheres[:, 3]).any():
        return np.ones(len(cones.axis), dtype=bool)
    toward = offset / distance[:, None]
    cosine = sum(axis[:, None] * part for axis, part in zip(cones.axis.T, toward.T, strict=True))
    reach = cones.half_rad[:, None] + np.arcsin(spheres[:, 3] / distance)
    return (cosine > np.cos(np.minimum(reach, np.float32(np.pi)))).any(axis=1)


def spheres_of(mesh: Mesh) -> np.ndarray:
    """Return (K, 4) float32 centre and radius around each instance, whose faces must follow one another."""
    if len(mesh) == 0:
        return np.zeros((0, 4), np.float32)
    first = np.flatnonzero(np.append(True, np.diff(mesh.instance) != 0))
    corner = mesh.vertices[mesh.faces]
    low = np.minimum.reduceat(corner.min(axis=1), first)
    high = np.maximum.reduceat(corner.max(axis=1), first)
    radius = 0.5 * np.linalg.norm(high - low, axis=1) + 0.01
    return np.concatenate([0.5 * (low + high), radius[:, None]], axis=1).astype(np.float32)


class ShadowMask:
    """A map of the possible shadows of moving objects along one direction.

    Objects are given by (K, 4) spheres, centre and radius; `toward` (3,) is the unit vector to the light, above the
    horizon.
    """

    def __init__(self, spheres: np.ndarray, toward: np.ndarray) -> None:
        self._slope = (toward[:2] / toward[2]).astype(np.float32)
        self._mask = np.zeros((_SIDE, _SIDE), dtype=bool)
        flat = float(np.hypot(*toward[:2]))
        along = toward[:2] / flat if flat > 1e-6 else np.array([1.0, 0.0])
        for x, y, z, radius in spheres.astype(np.float64):
            self._stamp(np.array([x, y]) - self._slope * z, along, radius / float(toward[2]), radius)

    def _stamp(self, middle: np.ndarray, along: np.ndarray, length_m: float, width_m: float) -> None:
        """Mark all cells that an ellipse may touch."""
        reach = np.hypot(along * length_m, along[::-1] * width_m) + 2 * _CELL_M
        x, y = (
            np.arange(int(np.floor((m - r) / _CELL_M)), int(np.floor((m + r) / _CELL_M)) + 1)
            for m, r in zip(middle, reach, strict=True)
        )
        dx, dy = ((x + 0.5) * _CELL_M - middle[0])[:, None], (y + 0.5) * _CELL_M - middle[1]
        first = (dx * along[0] + dy * along[1]) / (length_m + _CELL_M)
        second = (dy * along[0] - dx * along[1]) / (width_m + _CELL_M)
        rows, columns = np.nonzero(first**2 + second**2 < 1)
        self._mask[x[rows] & (_SIDE - 1), y[columns] & (_SIDE - 1)] = True

    def touches(self, points: np.ndarray) -> np.ndarray:
        """Return (R,) bool: whether a point (3, R) may be in one of the shadows."""
        row, column = (
            np.floor((points[k] - self._slope[k] * points[2]) * np.float32(1 / _CELL_M)).astype(np.int32) & (_SIDE - 1)
            for k in (0, 1)
        )
        return self._mask.ravel().take(row * _SIDE + column)
