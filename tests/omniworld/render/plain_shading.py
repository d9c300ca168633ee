"""Shading in plain numpy, all rays at once: what the compiled kernels are compared with."""

import numpy as np

from omniworld.assets.building import STOREY_M
from omniworld.render.capture import Shading
from omniworld.render.caster import Hits
from omniworld.render.light import CLOUDS_PX, LAMP_CELL_M, LAMP_CELLS, Light, cloud_pattern
from omniworld.render.snapshot import Shadows
from omniworld.render.surface import (
    COLOR,
    EMITTED,
    GLAZED,
    GLOSS,
    LAYER,
    NORMAL,
    UP,
    UV,
    UV_EDGE_1,
    UV_EDGE_2,
    Surfaces,
)
from omniworld.render.texture.atlas import LAYER_PX, LEVEL_START, LEVELS, MACRO_M, SIZE_PX, make_atlas

_LIFT_M = np.float32(0.02)
_WARM = np.array([1.0, 0.78, 0.50], np.float32)
_TINT = (np.arange(256) / 128).astype(np.float32)
_OWN = ((np.arange(256) / 255) ** 2).astype(np.float32)


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
    color[:, ground] = _surface_color(
        some, points, toward, attributes, cosine, sunlight, light=light, pixel_rad=pixel_rad
    )
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
    hits: Hits,
    points: np.ndarray,
    directions: np.ndarray,
    attributes: np.ndarray,
    cosine: np.ndarray,
    sunlight: tuple[np.ndarray, np.ndarray | None],
    light: Light,
    pixel_rad: float,
) -> np.ndarray:
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
    color: np.ndarray,
    directions: np.ndarray,
    attributes: np.ndarray,
    cosine: np.ndarray,
    tint: np.ndarray,
    light: Light,
) -> None:
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


def ambient(light: Light, up: np.ndarray) -> np.ndarray:
    """Return (3, R) light from sky and ground on surfaces whose normals have the upward component `up` (R,)."""
    sky = 0.5 * (light.zenith + light.horizon)
    fraction = 0.5 + 0.5 * up
    return sky[:, None] * fraction + light.bounce[:, None] * (1 - fraction)


def standing_water(light: Light, tint: np.ndarray, up: np.ndarray) -> np.ndarray:
    """Return (R,) mirror strength of wet surfaces; puddles are where the texture is dark. `tint`, `up` are (R,)."""
    return light.wet * np.clip((1.35 - tint) * 0.9, 0.15, 1) * np.clip(3 * up - 2, 0, 1)


def lamp_light(
    light: Light, base: np.ndarray, added: np.ndarray, tint: np.ndarray, attributes: np.ndarray, points: np.ndarray
) -> np.ndarray:
    """Return the (3, R) light after dark from surfaces that shine or are below a lamp.

    `base` (3, R) is the colour of the surfaces with their texture, `tint` (R,) the texture's factor in it, 0 in
    windows, and `added` (3, R) the texture's own colour; panes with bright curtains count as lit rooms. `attributes`
    (16, R) are those of `Surfaces`, `points` (3, R) world points.
    """
    shining = attributes[COLOR] * attributes[EMITTED]
    window = (attributes[GLAZED] > 0) & (tint < 0.02) & (added[0] > 0.1)
    shining += (added * _WARM[:, None]) * (np.float32(2.2) * window)
    if light.pools is not None:
        row, column = (
            np.floor(axis * np.float32(1 / LAMP_CELL_M)).astype(np.int32) & (LAMP_CELLS - 1) for axis in points[:2]
        )
        pool = light.pools[row * LAMP_CELLS + column] * (0.25 + 0.75 * np.maximum(attributes[UP], 0))
        shining += base * (0.9 * _WARM[:, None] * pool)
    return shining * np.float32(light.lamps)


def sky_color(light: Light, directions: np.ndarray) -> np.ndarray:
    """Return the linear colour (3, R) of the sky along unit directions (3, R); below the horizon the horizon's."""
    up = np.clip(directions[2], 0, 1)
    down = 1 - up
    fade = down * down * down  # several times faster than a power
    color = light.zenith[:, None] + (light.horizon - light.zenith)[:, None] * fade
    toward_sun = np.clip(dot(light.sun_direction, directions), 0, 1)
    if light.glow > 0:
        near = _squared(toward_sun, 3)
        color += light.sun[:, None] * (light.glow * (0.35 * near + 3.0 * _squared(near, 5)))
    cloud = _clouds(light, directions, up)
    shade = (light.horizon * 0.6 + light.sun * 0.45)[:, None] * (0.75 + 0.35 * toward_sun)
    return color + (shade - color) * cloud


def _squared(values: np.ndarray, times: int) -> np.ndarray:
    for _ in range(times):
        values = values * values
    return values


def dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the scalar products along the first axis, (3, ...)."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _clouds(light: Light, directions: np.ndarray, up: np.ndarray) -> np.ndarray:
    stretch = np.float32(CLOUDS_PX * 0.16) / (up + np.float32(0.18))
    column = (directions[0] * stretch + light.cloud_shift[0] * CLOUDS_PX).astype(np.int32) & (CLOUDS_PX - 1)
    row = (directions[1] * stretch + light.cloud_shift[1] * CLOUDS_PX).astype(np.int32) & (CLOUDS_PX - 1)
    density = cloud_pattern().take(row * CLOUDS_PX + column)
    edge = np.float32(1 - light.cloud_cover)
    return np.clip((density - edge) * 3.5, 0, 1) * np.clip(up * 8, 0, 1)


def sample(
    layer: np.ndarray, ground_step: np.ndarray, u_m: np.ndarray, v_m: np.ndarray, footprint_m: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the textures' tint (R,) float32, with the slow variation, and added linear colour (3, R) float32.

    Args:
        layer: (R,) int32 from `layer_of`.
        ground_step: (R,) int32 from `layer_of`.
        u_m: (R,) float32 along the surface.
        v_m: (R,) float32 along the surface; upwards from the ground on facades.
        footprint_m: (R,) float32 width of the pixel on the surface, which selects the mip level.
    """
    atlas = make_atlas()
    layer = layer + ground_step * (v_m < STOREY_M)
    texel_m = atlas.texel_m[layer]
    level = np.log2(np.maximum(footprint_m / texel_m, 1.0)).astype(np.int32)
    np.minimum(level, LEVELS - 1, out=level)
    column = np.floor(u_m / texel_m).astype(np.int32) & (SIZE_PX - 1)
    row = np.floor(v_m / texel_m).astype(np.int32) & (SIZE_PX - 1)
    index = layer * LAYER_PX + LEVEL_START[level] + ((row >> level) * (SIZE_PX >> level)) + (column >> level)
    texel = atlas.texels.take(index).view(np.uint8).reshape(-1, 4)
    scale = np.float32(SIZE_PX / MACRO_M)
    macro_row = np.floor(v_m * scale).astype(np.int32) & (SIZE_PX - 1)
    macro_column = np.floor(u_m * scale).astype(np.int32) & (SIZE_PX - 1)
    tint = _TINT.take(texel[:, 0]) * atlas.macro.take(macro_row * SIZE_PX + macro_column)
    return tint, np.stack([_OWN.take(texel[:, channel]) for channel in (1, 2, 3)])
