"""Colour of the sky, with clouds and the glow around the sun."""

from functools import lru_cache

import numpy as np

from omniocc.world.render.light import Light
from omniocc.world.render.texture.pattern import fractal

_SIZE = 512


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
    stretch = np.float32(_SIZE * 0.16) / (up + np.float32(0.18))
    column = (directions[0] * stretch + light.cloud_shift[0] * _SIZE).astype(np.int32) & (_SIZE - 1)
    row = (directions[1] * stretch + light.cloud_shift[1] * _SIZE).astype(np.int32) & (_SIZE - 1)
    density = _cloud_pattern().take(row * _SIZE + column)
    edge = np.float32(1 - light.cloud_cover)
    return np.clip((density - edge) * 3.5, 0, 1) * np.clip(up * 8, 0, 1)


@lru_cache(maxsize=1)
def _cloud_pattern() -> np.ndarray:
    """Return (N * N,) float32 tiling densities, evenly spread over 0..1 so that `cloud_cover` is a fraction."""
    noise = fractal(np.random.default_rng(19), _SIZE, 4, 6).ravel()
    rank = np.empty(noise.size, np.float32)
    rank[np.argsort(noise, kind="stable")] = np.arange(noise.size, dtype=np.float32) / noise.size
    return rank
