"""The light of a scene: sun, clouds, street lamps; and the exposure of its cameras."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from omniworld.mesh.material import Material
from omniworld.mesh.mesh import Mesh
from omniworld.render.texture.pattern import fractal

CLOUDS_PX = 512
LAMP_CELL_M = 0.5
LAMP_CELLS = 1024  # the map repeats after 512 m
_POOL_M = 20.0
_HEIGHT_M = 6.0


@dataclass(frozen=True)
class Light:
    """Sun, sky and air. Colours are linear RGB, (3,) float32; white paper in full sun is about 1 before exposure.

    Attributes:
        sun_direction: unit vector from the ground to the sun, world frame.
        sun: light on a surface that faces the sun.
        zenith: colour of the sky overhead; its mean with `horizon` lights what is in shadow.
        horizon: colour of the sky at the horizon, and of haze.
        bounce: light from the ground on surfaces that face down.
        glow: brightness of the sky around the sun.
        cloud_cover: fraction of the sky under clouds, 0..1.
        cloud_shift: (2,) offset into the cloud pattern, 0..1.
        haze_m: distance at which haze hides 63 % of an object's light.
        wet: how wet upward surfaces are, 0..1: darker, and mirrors of the sky where there are puddles.
        streaks: strength of rain streaks in the image, 0..1.
        lamps: brightness of street lamps, car lights and windows, 0 by day.
        pools: light on the ground below street lamps, from `omniworld.render.light.lamp_pools`.
    """

    sun_direction: np.ndarray
    sun: np.ndarray
    zenith: np.ndarray
    horizon: np.ndarray
    bounce: np.ndarray
    glow: float
    cloud_cover: float
    cloud_shift: np.ndarray
    haze_m: float
    wet: float = 0.0
    streaks: float = 0.0
    lamps: float = 0.0
    pools: np.ndarray | None = None


@dataclass(frozen=True)
class Sensor:
    """Exposure and noise of all cameras of a scene.

    Attributes:
        exposure: factor on linear light.
        white_balance: (3,) factors on red, green and blue.
        vignette: fraction of light lost at the rim of the lens.
        read_noise: standard deviation at black, of full scale in linear light.
        shot_noise: standard deviation at full scale.
    """

    exposure: float
    white_balance: np.ndarray
    vignette: float
    read_noise: float
    shot_noise: float


@lru_cache(maxsize=1)
def cloud_pattern() -> np.ndarray:
    """Return (N * N,) float32 tiling densities, evenly spread over 0..1 so that `cloud_cover` is a fraction."""
    noise = fractal(np.random.default_rng(19), CLOUDS_PX, 4, 6).ravel()
    rank = np.empty(noise.size, np.float32)
    rank[np.argsort(noise, kind="stable")] = np.arange(noise.size, dtype=np.float32) / noise.size
    return rank


def lamp_pools(mesh: Mesh) -> np.ndarray:
    """Return (1024 * 1024,) float32 light on level ground from the lamps above it, 1 right below a lamp.

    It is looked up by `kernel.lamp_shine`.
    """
    corner = mesh.vertices[mesh.faces[mesh.material == Material.LAMP]]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    down = normal[:, 2] < -0.5 * np.linalg.norm(normal, axis=1)
    places = np.unique(np.rint(corner[down].mean(axis=1)[:, :2]).astype(np.int64), axis=0)
    pools = np.zeros((LAMP_CELLS, LAMP_CELLS), np.float32)
    steps = np.arange(-int(_POOL_M / LAMP_CELL_M), int(_POOL_M / LAMP_CELL_M) + 1)
    distance = np.hypot(*np.meshgrid(steps * LAMP_CELL_M, steps * LAMP_CELL_M))
    rim = np.clip((_POOL_M - distance) / 8, 0, 1)
    stamp = (rim * (1 + (distance / _HEIGHT_M) ** 2) ** -1.5).astype(np.float32)
    for x, y in places:
        rows, columns = ((np.floor(value / LAMP_CELL_M).astype(int) + steps) % LAMP_CELLS for value in (x, y))
        pools[np.ix_(rows, columns)] = np.maximum(pools[np.ix_(rows, columns)], stamp)
    return pools.ravel()
