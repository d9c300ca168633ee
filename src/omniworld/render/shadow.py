"""Shadows of all static and moving objects, the ego car included."""

import numpy as np

from omniworld.render.caster import Caster
from omniworld.render.cull import ShadowMask
from omniworld.render.light import Light

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
