"""The image of one camera: colours, classes and ranges."""

from typing import NamedTuple

import numpy as np

from omniocc.classes import UNKNOWN
from omniworld.render.caster import Hits
from omniworld.render.exposure import develop
from omniworld.render.kernel import average, find_borders
from omniworld.render.light import Light, Sensor
from omniworld.render.rain import streaks
from omniworld.render.shade import Shading, shade
from omniworld.render.snapshot import Snapshot
from omniworld.render.view import View

_STEP_M = np.float32(0.08)  # least step in depth at which neighbouring pixels are smoothed
_STEP_FRACTION = np.float32(0.02)  # the same as a fraction of the distance


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
            hits.range_m,
            _STEP_M,
            _STEP_FRACTION,
            border,
            shadow,
        )
        _smooth(view, snapshot, np.flatnonzero(border | shadow), hits.face, shadow, seen.color, maybe)
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
    return shade(hits, eye, directions, snapshot.surfaces, snapshot.shadows, snapshot.light, view.pixel_rad)


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
