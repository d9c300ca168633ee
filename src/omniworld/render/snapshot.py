"""A scene at one time step, ready to be rendered: casters, surfaces, light and the ego pose."""

from dataclasses import dataclass

import numpy as np

from omniworld.mesh.mesh import Mesh
from omniworld.render.caster import Caster, Hits, Layers
from omniworld.render.cull import Cones, ShadowMask, may_hit
from omniworld.render.light import Light
from omniworld.render.surface import Surfaces

LOW_M = 2.5  # under clouds, objects above this height cast no shadow
_UP = np.array([0.12, 0.05, 0.9915], np.float32)


class Shadows:
    """Shadows at one time step, of static objects and of moving ones, which are inside `spheres` (K, 4).

    Without a sun, shadows fall straight down and only low objects cast them.
    """

    def __init__(self, static: Caster, movers: list[Caster], spheres: np.ndarray, light: Light) -> None:
        self._static = static
        self._movers = movers
        has_sun = bool(light.sun.any())
        self._toward = (light.sun_direction if has_sun else _UP)[None]
        self._limit_m = 1e37 if has_sun else LOW_M
        self._mask = ShadowMask(spheres, self._toward[0])

    def fall_on(self, points: np.ndarray) -> np.ndarray:
        """Return (R,) bool: whether an object is between a point (3, R) and the light."""
        result = self._static.blocked(points.T, self._toward, self._limit_m)
        maybe = np.flatnonzero(self._mask.touches(points) & ~result)
        some = np.take(points, maybe, axis=1).T
        for caster in self._movers:
            result[maybe] |= caster.blocked(some, self._toward, self._limit_m)
        return result


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
