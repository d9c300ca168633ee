"""Shading: from the hits of rays to colours."""

from typing import NamedTuple

import numpy as np

from omniocc.world.render.caster import Hits
from omniocc.world.render.lamp import lamp_light
from omniocc.world.render.light import Light, ambient, standing_water
from omniocc.world.render.shadow import Shadows
from omniocc.world.render.sky import dot, sky_color
from omniocc.world.render.surface import COLOR, GLAZED, GLOSS, LAYER, NORMAL, UP, UV, UV_EDGE_1, UV_EDGE_2, Surfaces
from omniocc.world.render.texture.atlas import sample

_LIFT_M = np.float32(0.02)  # start of shadow rays above their surface


class Shading(NamedTuple):
    """For R rays: linear colour (3, R), distance (R,) of the hit plane from the camera, and whether it is sunlit."""

    color: np.ndarray
    offset_m: np.ndarray
    lit: np.ndarray


def shade(
    hits: Hits, origin: np.ndarray, directions: np.ndarray, surfaces: Surfaces, shadows: Shadows, light: Light,
    pixel_rad: float,
) -> Shading:  # fmt: skip
    """Return the light along each ray: texture, sun with shadow, sky, reflection, haze; the sky where nothing is hit.

    `hits` are those of R rays from the camera at `origin` (3,) along unit `directions` (3, R) float32 in world axes,
    `surfaces` the tables of their faces; `pixel_rad` is the angle between neighbouring pixels.
    """
    color = np.empty((3, len(hits.face)), np.float32)
    offset_m, lit = np.zeros(len(hits.face), np.float32), np.zeros(len(hits.face), bool)
    sky, ground = np.flatnonzero(hits.face < 0), np.flatnonzero(hits.face >= 0)
    color[:, sky] = sky_color(light, np.take(directions, sky, axis=1))
    some, toward = hits.take(ground), np.take(directions, ground, axis=1)
    attributes = np.ascontiguousarray(surfaces.table.take(some.face, axis=0).T)
    cosine = -dot(attributes[NORMAL], toward)
    attributes[NORMAL] *= np.where(cosine < 0, np.float32(-1), np.float32(1))
    cosine = np.abs(cosine)
    sunlight = _sunlight(some, origin, toward, attributes[NORMAL], shadows, light)
    points = toward * some.range_m + origin[:, None] if light.lamps else toward
    color[:, ground] = _surface_color(some, points, toward, attributes, cosine, sunlight, light, pixel_rad)
    sunny, open_fraction = sunlight
    offset_m[ground], lit[ground] = some.range_m * cosine, sunny > 0 if open_fraction is None else open_fraction > 0.9
    return Shading(color, offset_m, lit)


def _sunlight(
    hits: Hits, origin: np.ndarray, directions: np.ndarray, normal: np.ndarray, shadows: Shadows, light: Light
) -> tuple[np.ndarray, np.ndarray | None]:
    """Return the (R,) cosine to the sun, 0 in shadow; and under clouds the fraction (R,) of sky that is open.

    Under clouds only level ground is tested: whether a car or another low object is above it.
    """
    covered = not light.sun.any()
    cosine = np.maximum(dot(normal, light.sun_direction), 0)
    index = np.flatnonzero(normal[2] > 0.8 if covered else cosine > 0)
    points = np.take(directions, index, axis=1) * hits.range_m.take(index)
    points += np.take(normal, index, axis=1) * _LIFT_M
    points += origin[:, None]
    dark = index[shadows.fall_on(points)]
    if not covered:
        cosine[dark] = 0
        return cosine, None
    fraction = np.ones(len(cosine), np.float32)
    fraction[dark] = 0
    return np.zeros_like(fraction), fraction


def _surface_color(
    hits: Hits, points: np.ndarray, directions: np.ndarray, attributes: np.ndarray, cosine: np.ndarray,
    sunlight: tuple[np.ndarray, np.ndarray | None], light: Light, pixel_rad: float,
) -> np.ndarray:  # fmt: skip
    u_m, v_m = attributes[UV] + hits.u * attributes[UV_EDGE_1] + hits.v * attributes[UV_EDGE_2]
    footprint_m = hits.range_m * np.float32(pixel_rad) / np.sqrt(np.maximum(cosine, 0.05))
    code = attributes[LAYER].astype(np.int32)
    tint, added = sample(code >> 1, code & 1, u_m, v_m, footprint_m)
    base = attributes[COLOR] * tint
    base += added
    sunny, open_fraction = sunlight
    sky = ambient(light, attributes[UP])
    if open_fraction is not None:
        sky *= 0.3 + 0.7 * open_fraction
    if light.sun.any():
        sky += light.sun[:, None] * sunny
    if light.wet:
        base *= 1 - 0.45 * light.wet * np.clip(attributes[UP] + 0.3, 0, 1)
    color = base * sky
    if light.lamps:
        color += lamp_light(light, base, added, tint, attributes, points)
    _mirror(color, directions, attributes, cosine, tint, light)
    clear = np.exp(hits.range_m * np.float32(-1 / light.haze_m))
    return color * clear + light.horizon[:, None] * (1 - clear)


def _mirror(
    color: np.ndarray, directions: np.ndarray, attributes: np.ndarray, cosine: np.ndarray, tint: np.ndarray,
    light: Light,
) -> None:  # fmt: skip
    """Add in place what glossy surfaces mirror by Schlick's Fresnel term: the sky; below the horizon a dim grey."""
    gloss = np.maximum(attributes[GLOSS], np.float32(0.8) * attributes[GLAZED] * (tint < 0.15))
    if light.wet:
        gloss = np.maximum(gloss, standing_water(light, tint, attributes[UP]))
    index = np.flatnonzero(gloss > 0)
    cosine, gloss = cosine[index], gloss[index]
    mirrored = directions[:, index] + 2 * cosine * attributes[NORMAL, index]
    seen = sky_color(light, mirrored)
    blend = np.clip(mirrored[2] * 4 + 0.3, 0, 1)
    seen = seen * blend + 0.12 * light.horizon[:, None] * (1 - blend)
    slant = 1 - np.minimum(cosine, 1)
    fraction = gloss * (0.06 + 0.94 * (slant * slant * slant * slant * slant))
    color[:, index] = color[:, index] * (1 - fraction) + np.minimum(seen, 3) * fraction
