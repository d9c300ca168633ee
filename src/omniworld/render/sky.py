"""The clouds of the sky."""

from functools import lru_cache

import numpy as np

from omniworld.render.texture.pattern import fractal

CLOUDS_PX = 512


@lru_cache(maxsize=1)
def cloud_pattern() -> np.ndarray:
    """Return (N * N,) float32 tiling densities, evenly spread over 0..1 so that `cloud_cover` is a fraction."""
    noise = fractal(np.random.default_rng(19), CLOUDS_PX, 4, 6).ravel()
    rank = np.empty(noise.size, np.float32)
    rank[np.argsort(noise, kind="stable")] = np.arange(noise.size, dtype=np.float32) / noise.size
    return rank
