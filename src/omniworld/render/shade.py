"""Shading: from the hits of rays to colours."""

from typing import NamedTuple

import numpy as np

from omniworld.render.caster import Hits
from omniworld.render.kernel import light_values, shade_rays, shadow_starts
from omniworld.render.light import Light
from omniworld.render.shadow import Shadows
from omniworld.render.sky import cloud_pattern
from omniworld.render.surface import Surfaces
from omniworld.render.texture.atlas import make_atlas

_NO_POOLS = np.zeros(0, np.float32)


class Shading(NamedTuple):
    """For R rays: linear colour (3, R), distance (R,) of the hit plane from the camera, and whether it is sunlit."""

    color: np.ndarray
    offset_m: np.ndarray
    lit: np.ndarray


def shade(
    hits: Hits,
    origin: np.ndarray,
    directions: np.ndarray,
    surfaces: Surfaces,
    shadows: Shadows,
    light: Light,
    pixel_rad: float,
) -> Shading:
    """Return the light along each ray: texture, sun with shadow, sky, reflection, haze; the sky where nothing is hit.

    Under clouds only level ground is tested for shadow: whether a car or another low object is above it.

    `hits` are those of R rays from the camera at `origin` (3,) along unit `directions` (3, R) float32 in world axes,
    `surfaces` the tables of their faces; `pixel_rad` is the angle between neighbouring pixels.
    """
    count = len(hits.face)
    hits, directions = Hits(*map(np.ascontiguousarray, hits)), np.ascontiguousarray(directions)
    values, table = light_values(light), surfaces.table
    points, rays = np.empty((3, count), np.float32), np.empty(count, np.int32)
    tested = shadow_starts(hits, directions, origin, table, values, points, rays)
    dark = np.zeros(count, bool)
    dark[rays[:tested]] = shadows.fall_on(points[:, :tested])
    shading = Shading(np.empty((3, count), np.float32), np.empty(count, np.float32), np.empty(count, bool))
    pools = _NO_POOLS if light.pools is None else light.pools
    look = make_atlas(), cloud_pattern(), pools, values, np.float32(pixel_rad)
    shade_rays(hits, dark, directions, origin, table, *look, *shading)
    return shading
