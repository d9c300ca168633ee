"""The image of one camera: colours by shading and exposure, classes and ranges."""

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from omniocc.classes import UNKNOWN
from omniworld.render.caster import Hits
from omniworld.render.kernel import average, develop_channel, find_borders, light_values, shade_rays, shadow_starts
from omniworld.render.light import Light, Sensor, cloud_pattern
from omniworld.render.snapshot import Shadows, Snapshot
from omniworld.render.surface import Surfaces
from omniworld.render.texture.atlas import make_atlas
from omniworld.render.view import View

_STEP_M = np.float32(0.08)  # least step in depth at which neighbouring pixels are smoothed
_STEP_FRACTION = np.float32(0.02)  # the same as a fraction of the distance
_NO_POOLS = np.zeros(0, np.float32)
_RAIN_PX = 512
_RAIN_SLANT = 0.12


class CameraImage(NamedTuple):
    """One image: `rgb` (H, W, 3) uint8, `label` (H, W) uint8, `range_m` (H, W) float32, as in `omniworld.Frame`."""

    rgb: np.ndarray
    label: np.ndarray
    range_m: np.ndarray


class RenderedPixels(NamedTuple):
    """Values of P pixels before exposure.

    Attributes:
        color: (3, P) float32, linear.
        label: (P,) uint8, 0 for the sky.
        range_m: (P,) float32, inf for the sky.
        key: (P,) int32 of the surface, see `omniworld.render.surface.Surfaces`.
        ego: (P,) bool, whether the ego car is seen.
    """

    color: np.ndarray
    label: np.ndarray
    range_m: np.ndarray
    key: np.ndarray
    ego: np.ndarray


class Shading(NamedTuple):
    """For R rays: linear colour (3, R), distance (R,) of the hit plane from the camera, and whether it is sunlit."""

    color: np.ndarray
    offset_m: np.ndarray
    lit: np.ndarray


def render_pixels(view: View, snapshot: Snapshot) -> RenderedPixels:
    """Cast the pixels' rays and shade what they hit.

    Every pixel gets a ray through its centre, which decides class and range. Where neighbours see different surfaces,
    or light beside shadow, further rays are cast and the colours averaged in linear light; elsewhere the texture's mip
    levels are averages already.
    """
    maybe = snapshot.may_hit(view.cones, view.origin_m)[view.cones.bundle]
    hits = snapshot.cast(view.origin_m, view.center, _ego_hits(view.ego_center_hits, snapshot), maybe)
    seen = _shade(view, snapshot, hits, view.center)
    surfaces = snapshot.surfaces
    if view.extra.shape[2]:
        border, shadow = np.zeros((2, len(view.pixel)), bool)
        find_borders(
            view.right,
            view.below,
            hits.face,
            surfaces.key,
            seen.lit,
            seen.offset_m,
            range_m=hits.range_m,
            step_m=_STEP_M,
            step_fraction=_STEP_FRACTION,
            surface=border,
            shadow=shadow,
        )
        _smooth(view, snapshot, np.flatnonzero(border | shadow), hits.face, shadow, seen.color, maybe=maybe)
    hit = hits.face >= 0
    key = np.where(hit, surfaces.key.take(hits.face), 0)
    label = np.where(hit, surfaces.label.take(hits.face), np.uint8(0))
    return RenderedPixels(seen.color, label, hits.range_m, key, hits.face >= snapshot.ego_start)


def expose(view: View, seen: RenderedPixels, light: Light, sensor: Sensor, rng: np.random.Generator) -> CameraImage:
    """Return the image of rendered pixels, with rain before the lens, exposure and noise.

    The ego car and pixels outside the lens have no class and no range.
    """
    color = seen.color
    if light.streaks:
        drops = streaks(view.size, view.pixel, rng) * light.streaks
        color = color + (0.9 * light.horizon[:, None] - color) * drops
    rgb = develop(color, sensor, view.falloff, rng)
    return CameraImage(
        _image(view, rgb, 0),
        _image(view, np.where(seen.ego, np.uint8(UNKNOWN), seen.label), UNKNOWN),
        _image(view, np.where(seen.ego, np.float32(np.nan), seen.range_m), np.nan),
    )


def _shade(view: View, snapshot: Snapshot, hits: Hits, directions_ego: np.ndarray) -> Shading:
    eye, directions = snapshot.world_point(view.origin_m), snapshot.world_directions(directions_ego)
    return shade(hits, eye, directions, snapshot.surfaces, snapshot.shadows, snapshot.light, pixel_rad=view.pixel_rad)


def _ego_hits(hits: Hits, snapshot: Snapshot) -> Hits:
    return hits._replace(face=np.where(hits.face >= 0, hits.face + snapshot.ego_start, -1))


def _smooth(
    view: View,
    snapshot: Snapshot,
    index: np.ndarray,
    face: np.ndarray,
    shadow: np.ndarray,
    color: np.ndarray,
    maybe: np.ndarray,
) -> None:
    """Set the colour (3, P) of the pixels `index` to the mean over all their rays, in place.

    A ray that hits the same triangle `face` (P,) as the centre ray gets its colour, unless a `shadow` (P,) ends there.
    """
    count = view.extra.shape[2]
    directions = np.take(view.extra, index, axis=1).reshape(3, -1)
    rays = (index[:, None] * count + np.arange(count)).ravel()
    hits = snapshot.cast(
        view.origin_m, directions, _ego_hits(view.ego_extra_hits.take(rays), snapshot), maybe[index].repeat(count)
    )
    other = np.flatnonzero((hits.face != face[index].repeat(count)) | shadow[index].repeat(count))
    shaded = _shade(view, snapshot, hits.take(other), np.take(directions, other, axis=1))
    average(color, index, other, shaded.color, count)


def _image(view: View, values: np.ndarray, outside: float | int) -> np.ndarray:
    image = np.full((view.size[0] * view.size[1], *values.shape[1:]), outside, values.dtype)
    image[view.pixel] = values
    return image.reshape(*view.size, *values.shape[1:])


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
    tested = shadow_starts(hits, directions, origin, table, values, points, rays=rays)
    dark = np.zeros(count, bool)
    dark[rays[:tested]] = shadows.fall_on(points[:, :tested])
    shading = Shading(np.empty((3, count), np.float32), np.empty(count, np.float32), np.empty(count, bool))
    pools = _NO_POOLS if light.pools is None else light.pools
    look = make_atlas(), cloud_pattern(), pools, values, np.float32(pixel_rad)
    shade_rays(hits, dark, directions, origin, table, *look, *shading)
    return shading


def streaks(size: tuple[int, int], pixel: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return (P,) float32 fraction, 0..1, of each pixel's view that drops hide.

    `size` is the image's height and width, `pixel` (P,) the index into the flattened image.
    """
    scale = _RAIN_PX / (1.2 * size[0])
    shift = rng.integers(0, _RAIN_PX, 2)
    row = ((pixel // size[1]) * scale + shift[0]).astype(np.int32) & (_RAIN_PX - 1)
    column = ((pixel % size[1]) * scale + shift[1]).astype(np.int32) & (_RAIN_PX - 1)
    return _rain()[row * _RAIN_PX + column]


@lru_cache(maxsize=1)
def _rain() -> np.ndarray:
    rng = np.random.default_rng(29)
    pattern = np.zeros((_RAIN_PX, _RAIN_PX), np.float32)
    for _ in range(700):
        length, width = int(rng.integers(14, 70)), int(rng.integers(1, 4))
        row, column, strength = int(rng.integers(_RAIN_PX)), int(rng.integers(_RAIN_PX)), rng.uniform(0.15, 0.6) / width
        rows = (row + np.arange(length)) % _RAIN_PX
        fade = np.sin(np.pi * (np.arange(length) + 0.5) / length)
        for offset in range(width):
            columns = (column + offset + np.rint(_RAIN_SLANT * np.arange(length)).astype(int)) % _RAIN_PX
            pattern[rows, columns] += (strength * fade).astype(np.float32)
    return np.minimum(pattern, 0.7).ravel()


def develop(linear: np.ndarray, sensor: Sensor, falloff: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Turn linear light (3, P) into RGB (P, 3) uint8; `falloff` (P,) is 0 on the axis and 1 at the rim.

    `rng` draws the noise.
    """
    gain = sensor.exposure * (1 - sensor.vignette * falloff)
    result = np.empty((linear.shape[1], 3), np.uint8)
    grain = _grain()
    noise = np.float32(sensor.read_noise), np.float32(sensor.shot_noise)
    for channel, balance in enumerate(sensor.white_balance):
        start = int(rng.integers(0, len(grain)))
        develop_channel(
            linear[channel], gain, balance, *noise, grain, start=start, curve=_CURVE, rgb=result, channel=channel
        )
    return result


def _tone_curve() -> np.ndarray:
    value = np.arange(4096) / 1024
    shoulder = value * (1 + value / 9) / (1 + 0.85 * value) * 1.08
    encoded = np.where(shoulder < 0.0031308, 12.92 * shoulder, 1.055 * np.maximum(shoulder, 1e-6) ** (1 / 2.4) - 0.055)
    return np.clip(np.rint(255 * encoded), 0, 255).astype(np.uint8)


_CURVE = _tone_curve()


@lru_cache(maxsize=1)
def _grain() -> np.ndarray:
    return np.random.default_rng(17).standard_normal(1 << 19).astype(np.float32)
