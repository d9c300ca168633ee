"""From linear light to bytes: exposure, white balance, vignette, noise and the tone curve."""

from functools import lru_cache

import numpy as np

from omniworld.render.kernel import develop_channel
from omniworld.render.light import Sensor


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
        develop_channel(linear[channel], gain, balance, *noise, grain, start, _CURVE, result, channel)
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
