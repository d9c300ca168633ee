"""The image of one camera: colours, classes and ranges."""

from typing import NamedTuple

import numpy as np

from omniocc.classes import UNKNOWN
from omniocc.world.render.caster import Hits
from omniocc.world.render.light import Light, Sensor, develop
from omniocc.world.render.rain import streaks
from omniocc.world.render.shade import Shading, shade
from omniocc.world.render.snapshot import Snapshot
from omniocc.world.render.view import View

_STEP_M = 0.08  # least step in depth at which neighbouring pixels are smoothed
_STEP_FRACTION = 0.02  # the same as a fraction of the distance
_SKY_M = 1e4  # range of the sky in comparisons


class CameraImage(NamedTuple):
    """One image: `rgb` (H, W, 3) uint8, `label` (H, W) uint8, `range_m` (H, W) float32, as in `omniocc.world.Frame`."""

    rgb: np.ndarray
    label: np.ndarray
    range_m: np.ndarray


class RenderedPixels(NamedTuple):
    """Values of P pixels before exposure.

    Attributes:
        color: (3, P) float32, linear.
        label: (P,) uint8, 0 for the sky.
        range_m: (P,) float32, inf for the sky.
        key: (P,) int32 of the surface, see `omniocc.world.render.surface.Surfaces`.
        ego: (P,) bool, whether the ego car is seen.
    """

    color: np.ndarray
    label: np.ndarray
    range_m: np.ndarray
    key: np.ndarray
    ego: np.ndarray


def render_pixels(view: View, snapshot: Snapshot) -> RenderedPixels:
    """Cast the pixels' rays and shade what they hit.

    Every pixel gets a ray through its centre, which decides class and range. Where neighbours see different surfaces,
    or light beside shadow, further rays are cast and the colours averaged in linear light; elsewhere the texture's mip
    levels are averages already.
    """
    maybe = snapshot.may_hit(view.cones, view.origin_m)[view.cones.bundle]
    hits = snapshot.cast(view.origin_m, view.center, _ego_hits(view.ego_center_hits, snapshot), maybe)
    seen = _shade(view, snapshot, hits, view.center)
    color, key = seen.color, np.where(hits.face >= 0, snapshot.surfaces.key.take(hits.face), 0)
    if view.extra.shape[2]:
        surface, shadow = _borders(view, key, seen, hits.range_m)
        index = np.flatnonzero(surface | shadow)
        color[:, index] = _smooth(view, snapshot, index, hits.face[index], shadow[index], color[:, index], maybe[index])
    label = np.where(hits.face >= 0, snapshot.surfaces.label.take(hits.face), np.uint8(0))
    return RenderedPixels(color, label, hits.range_m, key, hits.face >= snapshot.ego_start)


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
    return shade(hits, eye, directions, snapshot.surfaces, snapshot.shadows, snapshot.light, view.pixel_rad)


def _ego_hits(hits: Hits, snapshot: Snapshot) -> Hits:
    return hits._replace(face=np.where(hits.face >= 0, hits.face + snapshot.ego_start, -1))


def _smooth(
    view: View, snapshot: Snapshot, index: np.ndarray, face: np.ndarray, shadow: np.ndarray, center_color: np.ndarray,
    maybe: np.ndarray,
) -> np.ndarray:  # fmt: skip
    """Return the (3, E) mean colour of pixels `index` over all their rays.

    A ray that hits the same triangle `face` (E,) as the centre ray gets its colour, unless a `shadow` (E,) ends there.
    """
    count = view.extra.shape[2]
    directions = np.take(view.extra, index, axis=1).reshape(3, -1)
    rays = (index[:, None] * count + np.arange(count)).ravel()
    hits = snapshot.cast(
        view.origin_m, directions, _ego_hits(view.ego_extra_hits.take(rays), snapshot), maybe.repeat(count)
    )
    color = center_color.repeat(count, axis=1)
    other = np.flatnonzero((hits.face != face.repeat(count)) | shadow.repeat(count))
    color[:, other] = _shade(view, snapshot, hits.take(other), np.take(directions, other, axis=1)).color
    color, total = color.reshape(3, len(index), count), center_color
    for ray in range(count):
        total = total + np.minimum(color[:, :, ray], 4.0)
    return total / (count + 1)


def _borders(view: View, key: np.ndarray, seen: Shading, range_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return two (P,) bool arrays: whether a direct neighbour sees another surface, or only one of both is sunlit."""
    keys, lit = _image(view, key, 0), _image(view, seen.lit, False)
    plane, distance = _image(view, seen.offset_m, 0), _image(view, np.minimum(range_m, _SKY_M), _SKY_M)
    surface, shadow = np.zeros(view.size, dtype=bool), np.zeros(view.size, dtype=bool)
    for one, other in (((slice(None), slice(1, None)), (slice(None), slice(-1))), ((slice(1, None),), (slice(-1),))):
        # Facets of a crown differ in plane, a road at a grazing angle in range, separate objects in both.
        step = np.abs(plane[one] - plane[other]) > _STEP_M + _STEP_FRACTION * plane[one]
        step &= np.abs(distance[one] - distance[other]) > _STEP_M + _STEP_FRACTION * distance[one]
        differ = keys[one] != keys[other]
        for border, found in ((surface, differ | step), (shadow, (lit[one] != lit[other]) & ~differ)):
            border[one] |= found
            border[other] |= found
    return surface.ravel()[view.pixel], shadow.ravel()[view.pixel]


def _image(view: View, values: np.ndarray, outside: float | int) -> np.ndarray:
    image = np.full((view.size[0] * view.size[1], *values.shape[1:]), outside, values.dtype)
    image[view.pixel] = values
    return image.reshape(*view.size, *values.shape[1:])
