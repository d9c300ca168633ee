"""Attributes of triangles for shading: normal, colour, texture, gloss, emitted light."""

from typing import NamedTuple

import numpy as np

from omniworld.mesh.label import VEHICLE
from omniworld.mesh.material import Material
from omniworld.mesh.mesh import Mesh
from omniworld.render.texture.atlas import layer_of

NORMAL, COLOR = slice(0, 3), slice(3, 6)
UP = 2  # upward component of the normal
UV, UV_EDGE_1, UV_EDGE_2 = slice(6, 8), slice(8, 10), slice(10, 12)
LAYER, EMITTED, GLOSS, GLAZED = range(12, 16)
_GLOSS = {Material.GLASS: 0.9, Material.CAR_PAINT: 0.5, Material.METAL: 0.15, Material.FACADE: 0.0}
_GLAZED = (Material.FACADE, Material.GLASS)


class Surfaces(NamedTuple):
    """Attributes of all triangles in one table, so that a hit costs one gather.

    Attributes:
        table: (F, 16) float32, columns as named above: unit normal, linear base colour, uv of the first corner, uv of
            the two edges from it, twice the texture layer plus its ground step, light emitted after dark, gloss, and
            whether the texture contains glass.
        label: (F,) uint8.
        key: (F,) int32, differs between surfaces whose border needs smoothing.
    """

    table: np.ndarray
    label: np.ndarray
    key: np.ndarray


def make_surfaces(mesh: Mesh) -> Surfaces:
    """Return the tables of a mesh."""
    corner = mesh.vertices[mesh.faces]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    table = np.empty((len(mesh), 16), np.float32)
    table[:, NORMAL] = normal
    table[:, COLOR] = 0.85 * (mesh.color / 255) ** 2.2
    table[:, UV] = mesh.uv[:, 0]
    table[:, UV_EDGE_1] = mesh.uv[:, 1] - mesh.uv[:, 0]
    table[:, UV_EDGE_2] = mesh.uv[:, 2] - mesh.uv[:, 0]
    layer, ground_step = layer_of(mesh.material, mesh.color)
    table[:, LAYER], table[:, EMITTED] = 2 * layer + ground_step, lamp_strength(mesh)
    gloss = np.zeros(len(Material), np.float32)
    gloss[list(_GLOSS)] = list(_GLOSS.values())
    table[:, GLOSS] = gloss[mesh.material]
    table[:, GLAZED] = np.isin(mesh.material, _GLAZED)
    return Surfaces(table, mesh.label, _surface_key(mesh, normal))


def join(parts: list[Surfaces]) -> Surfaces:
    """Concatenate tables, in order."""
    return Surfaces(*map(np.concatenate, zip(*parts, strict=True)))


class SurfaceStack:
    """Tables whose first part is fixed and whose last part changes every frame; the first is copied only once."""

    def __init__(self, fixed: Surfaces) -> None:
        self._fixed = len(fixed.label)
        self._all = _enlarged(fixed, self._fixed + 16384)

    def topped(self, parts: list[Surfaces]) -> Surfaces:
        """Return the fixed part and then `parts`, in order; valid until the next call."""
        top = join(parts)
        end = self._fixed + len(top.label)
        if end > len(self._all.label):
            self._all = _enlarged(self._all, 2 * end)
        for whole, part in zip(self._all, top, strict=True):
            whole[self._fixed : end] = part
        return Surfaces(*(whole[:end] for whole in self._all))


def _enlarged(surfaces: Surfaces, size: int) -> Surfaces:
    """Return the tables with zeros at their ends, `size` rows in all."""
    more = size - len(surfaces.label)
    return Surfaces(*(np.concatenate([array, np.zeros((more, *array.shape[1:]), array.dtype)]) for array in surfaces))


def _surface_key(mesh: Mesh, normal: np.ndarray) -> np.ndarray:
    # The facets of a crown or hedge represent leaves, so their edges need no smoothing.
    facing = np.where((mesh.material == Material.LEAVES)[:, None], 0, np.rint(normal * 2)).astype(np.int32)
    parts = [mesh.label, mesh.material, *mesh.color.T, mesh.instance, *facing.T]
    key = np.zeros(len(mesh), np.uint32)
    for part in parts:
        # as the hash FNV-1a, whose prime this is
        key = (key ^ part.astype(np.int64).astype(np.uint32)) * np.uint32(16777619)
    return key.view(np.int32)


def lamp_strength(mesh: Mesh) -> np.ndarray:
    """Return (F,) float32 emitted light as a multiple of the base colour: lamps, head and tail lights; else 0."""
    red, green, blue = mesh.color.astype(np.int32).T
    vehicle = mesh.label == VEHICLE
    head = vehicle & (mesh.material == Material.GLASS) & (np.minimum(red, blue) > 200)
    tail = vehicle & (mesh.material == Material.SIGN) & (red > 120) & (np.maximum(green, blue) < 60)
    strength = np.where(mesh.material == Material.LAMP, np.float32(4), np.float32(0))
    strength[head], strength[tail] = 3, 2.5
    return strength
