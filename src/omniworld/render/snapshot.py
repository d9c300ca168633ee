"""A scene at one time step, ready to be rendered: casters, surfaces, light and the ego pose."""

from dataclasses import dataclass

import numpy as np

from omniworld.mesh.mesh import Mesh
from omniworld.render.caster import Hits, Layers
from omniworld.render.cull import Cones, may_hit
from omniworld.render.light import Light
from omniworld.render.shadow import Shadows
from omniworld.render.surface import Surfaces


@dataclass(frozen=True)
class Snapshot:
    """The world as cameras and LiDARs see it at one time step.

    Attributes:
        layers: static, then moving objects, without the ego car, in the world frame.
        shadows: of the same objects and of the ego car.
        surfaces: of static, moving and ego car faces, in this order.
        ego_start: first face of the ego car.
        rotation: (3, 3) float32, world frame from ego frame.
        origin_m: (3,) float32, the ego origin in the world frame.
        moving: mesh of the moving objects.
        spheres: (K, 4) float32 around each of them, world frame.
        light: light of the scene.
    """

    layers: Layers
    shadows: Shadows
    surfaces: Surfaces
    ego_start: int
    rotation: np.ndarray
    origin_m: np.ndarray
    moving: Mesh
    spheres: np.ndarray
    light: Light

    def world_directions(self, directions_ego: np.ndarray) -> np.ndarray:
        """Return (3, R) ego directions in the world frame."""
        # Sums instead of a matrix product, whose rounding may depend on threads.
        x, y, z = directions_ego
        return np.stack([row[0] * x + row[1] * y + row[2] * z for row in self.rotation])

    def world_point(self, point_ego: np.ndarray) -> np.ndarray:
        """Return an ego point in the world frame, (3,) float32."""
        return (self.rotation.astype(np.float64) @ point_ego + self.origin_m).astype(np.float32)

    def ego_points(self, points: np.ndarray) -> np.ndarray:
        """Return points (P, 3) float32 of the world frame in the ego frame."""
        x, y, z = (points - self.origin_m).T
        return np.stack([x * row[0] + y * row[1] + z * row[2] for row in self.rotation.T], axis=1)

    def may_hit(self, cones: Cones, point_ego: np.ndarray) -> np.ndarray:
        """Return (B,) bool: whether bundles of rays in the ego frame may hit a moving object."""
        return may_hit(
            cones._replace(axis=self.world_directions(cones.axis.T).T), self.world_point(point_ego), self.spheres
        )

    def cast(
        self,
        point_ego: np.ndarray,
        directions_ego: np.ndarray,
        known: Hits | None = None,
        maybe: np.ndarray | None = None,
    ) -> Hits:
        """Return the nearest hits from an ego point (3,) along ego directions (3, R).

        Hits on the ego car count only where `known` has them. `maybe` (R,) bool tells which rays may hit a moving
        object; None means all.
        """
        point, turned = self.world_point(point_ego), self.world_directions(directions_ego)
        directions = turned.T
        if maybe is None:
            return self.layers.cast(point[None], directions, known)
        hits = Layers(self.layers.casters[:1]).cast(point[None], directions, known)
        index = np.flatnonzero(maybe)
        found = self.layers.casters[1].cast(point[None], np.take(turned, index, axis=1).T, hits.range_m[index])
        hit = np.flatnonzero(found.face >= 0)
        found.face[:] += np.int32(self.layers.offsets[1])
        for result, some in zip(hits, found, strict=True):
            result[index[hit]] = some[hit]
        return hits
