"""One moment of a scene, ready to be seen: casters, surfaces, light and where the ego is."""

from dataclasses import dataclass

import numpy as np

from omniocc.world.caster import Hits, Layers
from omniocc.world.light import Light
from omniocc.world.mesh import Mesh
from omniocc.world.shade import Surfaces


@dataclass(frozen=True)
class Stage:
    """What cameras and LiDARs look at. The casters' frame is the world's, shifted so that numbers stay small.

    Attributes:
        layers: static things, moving things; the own car is not in it.
        shadows: the same and the own car.
        surfaces: of static, moving and own faces, in this order.
        own_start: first face of the own car.
        rotation: (3, 3) float32, caster frame from ego frame.
        origin_m: (3,) float32, the ego origin in the caster frame.
        moving: the moving things' mesh.
        light: of the scene.
    """

    layers: Layers
    shadows: Layers
    surfaces: Surfaces
    own_start: int
    rotation: np.ndarray
    origin_m: np.ndarray
    moving: Mesh
    light: Light

    def turn(self, directions_ego: np.ndarray) -> np.ndarray:
        """(3, R) ego directions in the caster frame."""
        # Sums instead of a matrix product, whose rounding may depend on threads.
        x, y, z = directions_ego
        return np.stack([row[0] * x + row[1] * y + row[2] * z for row in self.rotation])

    def place(self, point_ego: np.ndarray) -> np.ndarray:
        """(3,) float32 ego point in the caster frame."""
        return (self.rotation.astype(np.float64) @ point_ego + self.origin_m).astype(np.float32)

    def unplace(self, points: np.ndarray) -> np.ndarray:
        """(P, 3) float32 points of the caster frame in the ego frame."""
        x, y, z = (points - self.origin_m).T
        return np.stack([x * row[0] + y * row[1] + z * row[2] for row in self.rotation.T], axis=1)

    def cast(self, point_ego: np.ndarray, directions_ego: np.ndarray, known: Hits | None = None) -> Hits:
        """Nearest hits from one ego point (3,) along ego directions (3, R); of the own car only those `known`."""
        origins = repeat(self.place(point_ego), directions_ego.shape[1])
        return self.layers.cast(origins, self.turn(directions_ego).T, known)


def repeat(point: np.ndarray, count: int) -> np.ndarray:
    """(count, 3) view of one point."""
    return np.broadcast_to(point, (count, 3))
