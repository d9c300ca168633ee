"""Triangles with a class, a material and texture coordinates: the only thing the ray caster and the shader know of the world."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Mesh:
    """A triangle soup in world coordinates.

    Attributes:
        vertices: (V, 3) float32, metres, world frame.
        faces: (F, 3) int32 vertex indices, counter-clockwise seen from outside.
        uv: (F, 3, 2) float32 texture coordinates of each corner in metres on the surface (or along it), so that a texture keeps its size and
            moves with the object.
        label: (F,) uint8 class id, 1..11 (`omniocc.classes`).
        material: (F,) uint8 `omniocc.world.material.Material`.
        color: (F, 3) uint8 base colour, RGB.
        instance: (F,) int32, -1 for what never moves, otherwise the actor's id.
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
