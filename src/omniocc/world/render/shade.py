"""Shading: from the hits of rays to colours."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from omniocc.world.mesh.material import Material
from omniocc.world.mesh.mesh import Mesh
from omniocc.world.render.caster import Hits
from omniocc.world.render.lamp import lamp_light, lamp_strength
from omniocc.world.render.light import Light, ambient, standing_water
from omniocc.world.render.shadow import Shadows
from omniocc.world.render.sky import sky_color
from omniocc.world.render.texture.atlas import layer_of, sample

_GLOSS = {Material.GLASS: 0.9, Material.CAR_PAINT: 0.5, Material.METAL: 0.15, Material.FACADE: 0.0}
_GLAZED = (Material.FACADE, Material.GLASS)
_LIFT_M = np.float32(0.02)  # start of shadow rays above their surface


@dataclass(frozen=True)
class Surfaces:
    """Attributes of all triangles in one table, so that a hit costs one gather.

    Attributes:
        table: (F, 16) float32: unit normal 3, linear base colour 3, uv of the first corner 2, uv edges 2 + 2, twice the
            texture layer plus its ground step, light of its own after dark, gloss, and whether there is glass in the
            texture.
        label: (F,) uint8.
        key: (F,) int32, differs between surfaces whose border needs smoothing.
    """

    table: np.ndarray
    label: np.ndarray
    key: np.ndarray


def make_surfaces(mesh: Mesh) -> Surfaces:
    """Return the tables of a mesh."""
    corner = mesh.vertices[mesh.faces]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    table = np.empty((len(mesh), 16), np.float32)
    table[:, 0:3] = normal
    table[:, 3:6] = 0.85 * (mesh.color / 255) ** 2.2
    table[:, 6:8] = mesh.uv[:, 0]
    table[:, 8:10] = mesh.uv[:, 1] - mesh.uv[:, 0]
    table[:, 10:12] = mesh.uv[:, 2] - mesh.uv[:, 0]
    layer, ground_step = layer_of(mesh.material, mesh.color)
    table[:, 12], table[:, 13] = 2 * layer + ground_step, lamp_strength(mesh)
    gloss = np.zeros(len(Material), np.float32)
    gloss[list(_GLOSS)] = list(_GLOSS.values())
    table[:, 14] = gloss[mesh.material]
    table[:, 15] = np.isin(mesh.material, _GLAZED)
    return Surfaces(table, mesh.label, _surface_key(mesh, normal))


def join(parts: list[Surfaces]) -> Surfaces:
    """Concatenate tables, in order."""
    return Surfaces(
        np.concatenate([part.table for part in parts]),
        np.concatenate([part.label for part in parts]),
        np.concatenate([part.key for part in parts]),
    )


class SurfaceStack:
    """Tables whose first part is fixed and whose last part changes every frame; the first is copied only once.

    Args:
        fixed: the part that never changes.
    """

    def __init__(self, fixed: Surfaces) -> None:
        self._fixed = len(fixed.label)
        self._all = _enlarged(fixed, self._fixed + 16384)

    def topped(self, parts: list[Surfaces]) -> Surfaces:
        """Return the fixed part and then `parts`, in order; valid until the next call."""
        top = join(parts)
        end = self._fixed + len(top.label)
        if end > len(self._all.label):
            self._all = _enlarged(self._all, 2 * end)
        for whole, part in zip(_arrays(self._all), _arrays(top), strict=True):
            whole[self._fixed : end] = part
        return Surfaces(*(whole[:end] for whole in _arrays(self._all)))


def _arrays(surfaces: Surfaces) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return surfaces.table, surfaces.label, surfaces.key


def _enlarged(surfaces: Surfaces, size: int) -> Surfaces:
    def grown(array: np.ndarray) -> np.ndarray:
        result = np.zeros((size, *array.shape[1:]), array.dtype)
        result[: len(array)] = array
        return result

    return Surfaces(*(grown(array) for array in _arrays(surfaces)))


def _surface_key(mesh: Mesh, normal: np.ndarray) -> np.ndarray:
    # The facets of a crown or hedge stand for leaves, so their edges need no smoothing.
    facing = np.where((mesh.material == Material.LEAVES)[:, None], 0, np.rint(normal * 2)).astype(np.int32)
    parts = [mesh.label, mesh.material, *mesh.color.T, mesh.instance, *facing.T]
    key = np.zeros(len(mesh), np.uint32)
    for part in parts:
        key = (key ^ part.astype(np.int64).astype(np.uint32)) * np.uint32(16777619)
    return key.view(np.int32)


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

    Args:
        hits: of R rays from `origin` (3,) along `directions` (3, R) float32, world axes.
        origin: camera position.
        directions: unit vectors.
        surfaces: tables of the faces in `hits`.
        shadows: objects that block the light.
        light: light of the scene.
        pixel_rad: angle between neighbouring pixels.
    """
    color = np.empty((3, len(hits.face)), np.float32)
    offset_m, lit = np.zeros(len(hits.face), np.float32), np.zeros(len(hits.face), bool)
    sky, ground = np.flatnonzero(hits.face < 0), np.flatnonzero(hits.face >= 0)
    color[:, sky] = sky_color(light, np.take(directions, sky, axis=1))
    some, toward = hits.take(ground), np.take(directions, ground, axis=1)
    attributes = np.ascontiguousarray(surfaces.table.take(some.face, axis=0).T)
    cosine = -_dot(attributes[:3], toward)
    attributes[:3] *= np.where(cosine < 0, np.float32(-1), np.float32(1))
    cosine = np.abs(cosine)
    sunlight = _sunlight(some, origin, toward, attributes[:3], shadows, light)
    points = toward * some.range_m + origin[:, None] if light.lamps else toward
    color[:, ground] = _surface_color(some, points, toward, attributes, cosine, sunlight, light, pixel_rad)
    sunny, open_share = sunlight
    offset_m[ground], lit[ground] = some.range_m * cosine, sunny > 0 if open_share is None else open_share > 0.9
    return Shading(color, offset_m, lit)


def _sunlight(
    hits: Hits, origin: np.ndarray, directions: np.ndarray, normal: np.ndarray, shadows: Shadows, light: Light
) -> tuple[np.ndarray, np.ndarray | None]:
    """Return the (R,) cosine to the sun, 0 in shadow; and under clouds the fraction (R,) of sky that is open.

    Under clouds only level ground is tested: whether a car or another low object stands over it.
    """
    covered = not light.sun.any()
    cosine = np.maximum(_dot(normal, light.sun_direction), 0)
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
    u_m = attributes[6] + hits.u * attributes[8] + hits.v * attributes[10]
    v_m = attributes[7] + hits.u * attributes[9] + hits.v * attributes[11]
    footprint_m = hits.range_m * np.float32(pixel_rad) / np.sqrt(np.maximum(cosine, 0.05))
    code = attributes[12].astype(np.int32)
    tint, own = sample(code >> 1, code & 1, u_m, v_m, footprint_m)
    base = attributes[3:6] * tint
    base += own
    sunny, open_share = sunlight
    sky = ambient(light, attributes[2])
    if open_share is not None:
        sky *= 0.3 + 0.7 * open_share
    if light.sun.any():
        sky += light.sun[:, None] * sunny
    water = standing_water(light, tint, attributes[2]) if light.wet else np.zeros(0, np.float32)
    if light.wet:
        base *= 1 - 0.45 * light.wet * np.clip(attributes[2] + 0.3, 0, 1)
    color = base * sky
    if light.lamps:
        color += lamp_light(light, base, own, tint, attributes, points)
    _mirror(color, directions, attributes, cosine, tint, water, light)
    clear = np.exp(hits.range_m * np.float32(-1 / light.haze_m))
    return color * clear + light.horizon[:, None] * (1 - clear)


def _mirror(
    color: np.ndarray,
    directions: np.ndarray,
    attributes: np.ndarray,
    cosine: np.ndarray,
    tint: np.ndarray,
    water: np.ndarray,
    light: Light,
) -> None:
    """Add what glossy surfaces reflect, in place."""
    gloss = np.maximum(attributes[14], np.float32(0.8) * attributes[15] * (tint < 0.15))
    if len(water):
        gloss = np.maximum(gloss, water)
    index = np.flatnonzero(gloss > 0)
    color[:, index] = _reflect(
        color[:, index], directions[:, index], attributes[:3, index], cosine[index], gloss[index], light
    )


def _reflect(
    color: np.ndarray, directions: np.ndarray, normal: np.ndarray, cosine: np.ndarray, gloss: np.ndarray, light: Light
) -> np.ndarray:
    """Add the mirrored sky, or an even dim grey below the horizon, by Schlick's Fresnel term."""
    mirrored = directions + 2 * cosine * normal
    seen = sky_color(light, mirrored)
    blend = np.clip(mirrored[2] * 4 + 0.3, 0, 1)
    seen = seen * blend + 0.12 * light.horizon[:, None] * (1 - blend)
    slant = 1 - np.minimum(cosine, 1)
    fraction = gloss * (0.06 + 0.94 * (slant * slant * slant * slant * slant))
    return color * (1 - fraction) + np.minimum(seen, 3) * fraction


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
