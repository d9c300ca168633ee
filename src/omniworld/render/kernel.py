"""Colours of rays from their hits, compiled by numba: texture, sun, sky, reflection, lamps, haze; borders; exposure.

All kernels are in one file, see `rayiou.compiled`. Arrays of R rays are (3, R) for points, directions and colours.
"""

from math import exp, floor, sqrt
from typing import NamedTuple, no_type_check

import numpy as np

from omniworld.assets.building import STOREY_M
from omniworld.render.light import CLOUDS_PX, LAMP_CELL_M, LAMP_CELLS, Light
from omniworld.render.surface import COLOR, EMITTED, GLAZED, GLOSS, LAYER, NORMAL, UV, UV_EDGE_1, UV_EDGE_2
from omniworld.render.texture.atlas import LAYER_PX, LEVEL_START, LEVELS, MACRO_M, SIZE_PX
from rayiou.compiled import compiled

LIFT_M = 0.02
"""Start of shadow rays above their surface."""
OPEN = 0.8
"""Least upward component of the normals of surfaces on which low objects cast shadows under clouds."""
_LAMP_RED, _LAMP_GREEN, _LAMP_BLUE = 1.0, 0.78, 0.50
_RED, _U, _U1, _U2 = COLOR.start, UV.start, UV_EDGE_1.start, UV_EDGE_2.start
_NX = NORMAL.start
_SQUARE = ((np.arange(256) / 255) ** 2).astype(np.float32)


Rgb = tuple[np.float32, np.float32, np.float32]


class LightValues(NamedTuple):
    """The values of `Light` without arrays, whose references compiled loops would count again and again."""

    sun_direction: Rgb
    sun: Rgb
    zenith: Rgb
    horizon: Rgb
    bounce: Rgb
    cloud_shift: tuple[np.float32, np.float32]
    glow: np.float32
    cloud_cover: np.float32
    haze_m: np.float32
    wet: np.float32
    lamps: np.float32


def light_values(light: Light) -> LightValues:
    """Return the values that colours depend on, except `pools`."""
    vectors = light.sun_direction, light.sun, light.zenith, light.horizon, light.bounce, light.cloud_shift
    numbers = light.glow, light.cloud_cover, light.haze_m, light.wet, light.lamps
    return LightValues(*(tuple(map(np.float32, vector)) for vector in vectors), *map(np.float32, numbers))  # type: ignore[arg-type]


@compiled
@no_type_check
def facing(table, face, x, y, z):
    """Return the normal of a face, turned against a ray along (x, y, z), and its cosine to the ray."""
    nx, ny, nz = table[face, _NX], table[face, _NX + 1], table[face, _NX + 2]
    cosine = -(nx * x + ny * y + nz * z)
    return (-nx, -ny, -nz, -cosine) if cosine < 0 else (nx, ny, nz, cosine)


@compiled
@no_type_check
def shadow_starts(hits, directions, origin, table, light, points, rays):
    """Fill `points` (3, R) and `rays` (R,) where a shadow may fall, at the front; return their number.

    That is where the sun shines on a surface from its front; under clouds, on level ground.
    """
    sun = light.sun_direction
    covered = light.sun[0] + light.sun[1] + light.sun[2] <= 0
    face, range_m = hits.face, hits.range_m
    count = 0
    for ray in range(len(face)):
        if face[ray] < 0:
            continue
        x, y, z = directions[0, ray], directions[1, ray], directions[2, ray]
        nx, ny, nz, _ = facing(table, face[ray], x, y, z)
        if nz <= OPEN if covered else nx * sun[0] + ny * sun[1] + nz * sun[2] <= 0:
            continue
        points[0, count] = x * range_m[ray] + nx * LIFT_M + origin[0]
        points[1, count] = y * range_m[ray] + ny * LIFT_M + origin[1]
        points[2, count] = z * range_m[ray] + nz * LIFT_M + origin[2]
        rays[count] = ray
        count += 1
    return count


@compiled
@no_type_check
def sky_color(x, y, z, clouds, light):
    """Return the red, green and blue of the sky along (x, y, z), with clouds and the glow around the sun.

    Below the horizon it is the horizon's colour.
    """
    up = min(max(z, 0.0), 1.0)
    fade = (1 - up) * (1 - up) * (1 - up)
    sun = light.sun_direction
    toward_sun = min(max(sun[0] * x + sun[1] * y + sun[2] * z, 0.0), 1.0)
    near = toward_sun * toward_sun
    near *= near
    near *= near
    center = near * near
    center *= center
    center *= center
    center *= center
    center *= center
    glow = light.glow * (0.35 * near + 3.0 * center)
    stretch = CLOUDS_PX * 0.16 / (up + 0.18)
    column = int(x * stretch + light.cloud_shift[0] * CLOUDS_PX) & (CLOUDS_PX - 1)
    row = int(y * stretch + light.cloud_shift[1] * CLOUDS_PX) & (CLOUDS_PX - 1)
    density = (clouds[row * CLOUDS_PX + column] - (1 - light.cloud_cover)) * 3.5
    cloud = min(max(density, 0.0), 1.0) * min(up * 8, 1.0)
    shade = 0.75 + 0.35 * toward_sun
    red = light.zenith[0] + (light.horizon[0] - light.zenith[0]) * fade + light.sun[0] * glow
    green = light.zenith[1] + (light.horizon[1] - light.zenith[1]) * fade + light.sun[1] * glow
    blue = light.zenith[2] + (light.horizon[2] - light.zenith[2]) * fade + light.sun[2] * glow
    red += ((light.horizon[0] * 0.6 + light.sun[0] * 0.45) * shade - red) * cloud
    green += ((light.horizon[1] * 0.6 + light.sun[1] * 0.45) * shade - green) * cloud
    blue += ((light.horizon[2] * 0.6 + light.sun[2] * 0.45) * shade - blue) * cloud
    return red, green, blue


@compiled
@no_type_check
def sample(layer, ground_step, u_m, v_m, footprint_m, texels, texel_sizes_m, macro):
    """Return a texture's tint, with the slow variation, and its own red, green and blue, linear.

    Args:
        layer: texture layer, see `atlas.layer_of`.
        ground_step: from there to that of the ground floor.
        u_m: along the surface.
        v_m: along the surface; upwards from the ground on facades.
        footprint_m: width of the pixel on the surface, which selects the mip level.
        texels: of all textures, see `atlas.Atlas`.
        texel_sizes_m: its `texel_m`.
        macro: its slow variation.
    """
    if v_m < STOREY_M:
        layer += ground_step
    texel_m = texel_sizes_m[layer]
    level, width_m = 0, footprint_m
    while width_m >= 2 * texel_m and level < LEVELS - 1:
        width_m *= 0.5
        level += 1
    column = floor(u_m / texel_m) & (SIZE_PX - 1)
    row = floor(v_m / texel_m) & (SIZE_PX - 1)
    index = layer * LAYER_PX + LEVEL_START[level] + (row >> level) * (SIZE_PX >> level) + (column >> level)
    texel = texels[index]
    scale = SIZE_PX / MACRO_M
    slow = (floor(v_m * scale) & (SIZE_PX - 1)) * SIZE_PX + (floor(u_m * scale) & (SIZE_PX - 1))
    red, green, blue = _SQUARE[texel >> 8 & 255], _SQUARE[texel >> 16 & 255], _SQUARE[texel >> 24]
    return (texel & 255) / 128 * macro[slow], red, green, blue


@compiled
@no_type_check
def lamp_shine(pools, x_m, y_m, up):
    """Return the light of street lamps on a surface at world x and y with a normal of upward component `up`.

    `pools` are from `light.lamp_pools`, empty where no lamps are lit.
    """
    if len(pools) == 0:
        return 0.0
    row, column = floor(x_m / LAMP_CELL_M) & (LAMP_CELLS - 1), floor(y_m / LAMP_CELL_M) & (LAMP_CELLS - 1)
    return 0.9 * pools[row * LAMP_CELLS + column] * (0.25 + 0.75 * max(up, 0.0))


@compiled
@no_type_check
def mirror_strength(table, face, tint, up, light):
    """Return how much a surface mirrors; puddles are where the texture is dark."""
    gloss = table[face, GLOSS]
    if tint < 0.15:
        gloss = max(gloss, 0.8 * table[face, GLAZED])
    if light.wet > 0:
        water = light.wet * min(max((1.35 - tint) * 0.9, 0.15), 1.0) * min(max(3 * up - 2, 0.0), 1.0)
        gloss = max(gloss, water)
    return gloss


@compiled
@no_type_check
def mirrored_sky(x, y, z, clouds, light):
    """Return what a surface mirrors along (x, y, z): the sky, at most 3; below the horizon a dim grey."""
    red, green, blue = sky_color(x, y, z, clouds, light)
    blend = min(max(z * 4 + 0.3, 0.0), 1.0)
    grey = 0.12 * (1 - blend)
    return (
        min(red * blend + grey * light.horizon[0], 3.0),
        min(green * blend + grey * light.horizon[1], 3.0),
        min(blue * blend + grey * light.horizon[2], 3.0),
    )


@compiled
@no_type_check
def shade_rays(hits, dark, directions, origin, table, atlas, clouds, pools, light, pixel_rad, color, offset_m, lit):
    """Fill the linear colour (3, R) of each ray, the distance (R,) of the hit plane, and whether it is sunlit.

    `dark` (R,) bool is whether a shadow falls there. See `omniworld.render.capture`.
    """
    sun, zenith, horizon, bounce = light.sun, light.zenith, light.horizon, light.bounce
    covered = sun[0] + sun[1] + sun[2] <= 0
    faces, ranges_m, weights_u, weights_v = hits.face, hits.range_m, hits.u, hits.v
    texels, texel_m, macro = atlas.texels, atlas.texel_m, atlas.macro
    for ray in range(len(faces)):
        x, y, z = directions[0, ray], directions[1, ray], directions[2, ray]
        face, range_m = faces[ray], ranges_m[ray]
        if face < 0:
            color[0, ray], color[1, ray], color[2, ray] = sky_color(x, y, z, clouds, light)
            offset_m[ray], lit[ray] = 0, False
            continue
        nx, ny, nz, cosine = facing(table, face, x, y, z)
        sunny = 0.0
        if not covered and not dark[ray]:
            sunny = max(nx * light.sun_direction[0] + ny * light.sun_direction[1] + nz * light.sun_direction[2], 0.0)
        offset_m[ray], lit[ray] = range_m * cosine, not dark[ray] if covered else sunny > 0

        u, v = weights_u[ray], weights_v[ray]
        u_m = table[face, _U] + u * table[face, _U1] + v * table[face, _U2]
        v_m = table[face, _U + 1] + u * table[face, _U1 + 1] + v * table[face, _U2 + 1]
        footprint_m = range_m * pixel_rad / sqrt(max(cosine, 0.05))
        code = int(table[face, LAYER])
        tint, own_red, own_green, own_blue = sample(
            code >> 1, code & 1, u_m, v_m, footprint_m, texels, texel_sizes_m=texel_m, macro=macro
        )
        red = table[face, _RED] * tint + own_red
        green = table[face, _RED + 1] * tint + own_green
        blue = table[face, _RED + 2] * tint + own_blue
        if light.wet > 0:
            damp = 1 - 0.45 * light.wet * min(max(nz + 0.3, 0.0), 1.0)
            red, green, blue = red * damp, green * damp, blue * damp

        above = 0.5 + 0.5 * nz
        open_sky = 0.3 if covered and dark[ray] else 1.0
        light_red = (0.5 * (zenith[0] + horizon[0]) * above + bounce[0] * (1 - above)) * open_sky + sun[0] * sunny
        light_green = (0.5 * (zenith[1] + horizon[1]) * above + bounce[1] * (1 - above)) * open_sky + sun[1] * sunny
        light_blue = (0.5 * (zenith[2] + horizon[2]) * above + bounce[2] * (1 - above)) * open_sky + sun[2] * sunny
        if light.lamps > 0:
            shine = light.lamps * lamp_shine(pools, x * range_m + origin[0], y * range_m + origin[1], nz)
            light_red, light_green = light_red + shine * _LAMP_RED, light_green + shine * _LAMP_GREEN
            light_blue += shine * _LAMP_BLUE
        red, green, blue = red * light_red, green * light_green, blue * light_blue
        if light.lamps > 0:
            window = 0.0
            if table[face, GLAZED] > 0 and tint < 0.02 and own_red > 0.1:  # a pane with bright curtains is a lit room
                window = 2.2 * light.lamps
            emitted = table[face, EMITTED] * light.lamps
            red += table[face, _RED] * emitted + own_red * _LAMP_RED * window
            green += table[face, _RED + 1] * emitted + own_green * _LAMP_GREEN * window
            blue += table[face, _RED + 2] * emitted + own_blue * _LAMP_BLUE * window

        gloss = mirror_strength(table, face, tint, nz, light)
        if gloss > 0:
            away = 2 * cosine
            seen = mirrored_sky(x + away * nx, y + away * ny, z + away * nz, clouds, light)
            slant = 1 - min(cosine, 1.0)
            slant5 = slant * slant * slant * slant * slant
            fraction = gloss * (0.06 + 0.94 * slant5)  # Schlick's Fresnel term
            red += (seen[0] - red) * fraction
            green += (seen[1] - green) * fraction
            blue += (seen[2] - blue) * fraction
        clear = exp(-range_m / light.haze_m)
        color[0, ray] = red * clear + horizon[0] * (1 - clear)
        color[1, ray] = green * clear + horizon[1] * (1 - clear)
        color[2, ray] = blue * clear + horizon[2] * (1 - clear)


@compiled
@no_type_check
def find_borders(right, below, face, keys, lit, plane_m, range_m, step_m, step_fraction, surface, shadow):
    """Mark pixels with a direct neighbour that sees another surface, or of which only one is sunlit.

    `right` and `below` (P,) are the indices of the neighbours, -1 without one. Facets of a crown differ in plane, a
    road at a grazing angle in range, separate objects in both.
    """
    for pixel in range(len(right)):
        key = keys[face[pixel]] if face[pixel] >= 0 else 0
        for other in (right[pixel], below[pixel]):
            if other < 0:
                continue
            differ = key != (keys[face[other]] if face[other] >= 0 else 0)
            if not differ:
                plane_step, range_step = abs(plane_m[pixel] - plane_m[other]), abs(range_m[pixel] - range_m[other])
                apart = plane_step > step_m + step_fraction * plane_m[other]
                differ = apart and range_step > step_m + step_fraction * range_m[other]
            if differ:
                surface[pixel] = surface[other] = True
            elif lit[pixel] != lit[other]:
                shadow[pixel] = shadow[other] = True


@compiled
@no_type_check
def average(color, pixels, others, other_color, count):
    """Set the colour (3, P) of `pixels` to the mean over their centre ray and `count` further rays.

    The further rays are numbered pixel after pixel; `others` are the numbers of those with a colour of their own,
    `other_color` (3, O), ascending, and the rest have that of the centre.
    """
    for channel in range(3):
        used = 0
        for place in range(len(pixels)):
            center = color[channel, pixels[place]]
            total = center
            for ray in range(place * count, (place + 1) * count):
                value = center
                if used < len(others) and others[used] == ray:
                    value = other_color[channel, used]
                    used += 1
                total += min(value, 4.0)
            color[channel, pixels[place]] = total / (count + 1)


@compiled
@no_type_check
def develop_channel(linear, gain, balance, read_noise, shot_noise, grain, start, curve, rgb, channel):
    """Fill a channel of `rgb` (P, 3) uint8 from linear light (P,), with noise from `grain` onwards at `start`."""
    size = len(grain)
    last = len(curve) - 1
    for pixel in range(len(linear)):
        value = max(linear[pixel] * (gain[pixel] * balance), 0.0)
        value += grain[(start + pixel) % size] * (read_noise + shot_noise * sqrt(min(value, 1.0)))
        rgb[pixel, channel] = curve[int(min(max(value * 1024, 0.0), last))]
