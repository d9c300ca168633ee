"""Triangles with a class, a material and texture coordinates, the input of ray caster and shader."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from omniworld.mesh.material import Material

_FACE_ARRAYS = ("uv", "label", "material", "color", "instance")


@dataclass(frozen=True)
class Mesh:
    """A list of triangles.

    Attributes:
        vertices: (V, 3) float32, metres, in the frame of the place or of a prototype.
        faces: (F, 3) int32 vertex indices, counter-clockwise seen from outside.
        uv: (F, 3, 2) float32 texture coordinates of each corner in metres on the surface, so that a
            texture keeps its size and moves with the object.
        label: (F,) uint8 class id, 1..11 (`omniocc.classes`).
        material: (F,) uint8 `Material`.
        color: (F, 3) uint8 base colour, RGB.
        instance: (F,) int32: an actor's id, -1 for static faces, below -1 for lit lamps of a traffic light.
    """

    vertices: np.ndarray
    faces: np.ndarray
    uv: np.ndarray
    label: np.ndarray
    material: np.ndarray
    color: np.ndarray
    instance: np.ndarray

    def __len__(self) -> int:
        return len(self.faces)


def empty() -> Mesh:
    """Return a mesh without faces."""
    return Mesh(
        np.zeros((0, 3), np.float32),
        np.zeros((0, 3), np.int32),
        np.zeros((0, 3, 2), np.float32),
        np.zeros(0, np.uint8),
        np.zeros(0, np.uint8),
        np.zeros((0, 3), np.uint8),
        instance=np.zeros(0, np.int32),
    )


def concatenate(meshes: Iterable[Mesh]) -> Mesh:
    """Return all faces in one mesh, in the given order."""
    parts = [mesh for mesh in meshes if len(mesh)]
    if not parts:
        return empty()
    first_vertex = np.cumsum([0] + [len(mesh.vertices) for mesh in parts[:-1]])
    return Mesh(
        np.concatenate([mesh.vertices for mesh in parts]),
        np.concatenate([mesh.faces + np.int32(first) for mesh, first in zip(parts, first_vertex, strict=True)]),
        *(np.concatenate([getattr(mesh, name) for mesh in parts]) for name in _FACE_ARRAYS),
    )


def transform(mesh: Mesh, a_from_b: np.ndarray) -> Mesh:
    """Return the mesh of frame b in frame a; `a_from_b` is (4, 4), a rotation (or uniform scale) and a shift."""
    vertices = mesh.vertices @ a_from_b[:3, :3].T.astype(np.float32) + a_from_b[:3, 3].astype(np.float32)
    return replace(mesh, vertices=vertices)


def with_instance(mesh: Mesh, instance: int) -> Mesh:
    """Return the same faces, all belonging to one actor."""
    return replace(mesh, instance=np.full(len(mesh), instance, np.int32))


def instances(mesh: Mesh, a_from_b: np.ndarray, paint: Mapping[Material, np.ndarray]) -> Mesh:
    """Return copies of one mesh (frame b), posed and repainted.

    `a_from_b` has one pose (K, 4, 4) per copy, which may stretch it; `paint` the (K, 3) uint8 colours of the copies'
    faces of some materials, where the others keep the prototype's.
    """
    count, vertex_count, face_count = len(a_from_b), len(mesh.vertices), len(mesh)
    linear, shift = a_from_b[:, :3, :3].astype(np.float32), a_from_b[:, None, :3, 3].astype(np.float32)
    vertices = (mesh.vertices @ linear.transpose(0, 2, 1) + shift).reshape(-1, 3)
    offsets = (np.arange(count, dtype=np.int32) * vertex_count)[:, None, None]
    colors = np.empty((count, face_count, 3), np.uint8)
    colors[:] = mesh.color
    for material, color in paint.items():
        colors[:, mesh.material == material] = color[:, None]
    return Mesh(
        vertices,
        (mesh.faces + offsets).reshape(-1, 3),
        np.tile(mesh.uv, (count, 1, 1)),
        np.tile(mesh.label, count),
        np.tile(mesh.material, count),
        colors.reshape(-1, 3),
        instance=np.tile(mesh.instance, count),
    )
