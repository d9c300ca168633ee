"""The light of a scene, and the exposure of its cameras."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np


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
        pools: light on the ground below street lamps, from `omniocc.world.render.lamp.lamp_pools`.
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


def ambient(light: Light, up: np.ndarray) -> np.ndarray:
    """Return (3, R) light from sky and ground on surfaces whose normals have the upward component `up` (R,)."""
    sky = 0.5 * (light.zenith + light.horizon)
    fraction = 0.5 + 0.5 * up
    return sky[:, None] * fraction + light.bounce[:, None] * (1 - fraction)


def standing_water(light: Light, tint: np.ndarray, up: np.ndarray) -> np.ndarray:
    """Return (R,) mirror strength of wet surfaces; puddles are where the texture is dark. `tint`, `up` are (R,)."""
    return light.wet * np.clip((1.35 - tint) * 0.9, 0.15, 1) * np.clip(3 * up - 2, 0, 1)


def develop(linear: np.ndarray, sensor: Sensor, falloff: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Turn linear light (3, P) into RGB (P, 3) uint8; `falloff` (P,) is 0 on the axis and 1 at the rim.

    `rng` draws the noise.
    """
    gain = sensor.exposure * (1 - sensor.vignette * falloff)
    result = np.empty((linear.shape[1], 3), np.uint8)
    grain = _grain()
    for channel in range(3):
        value = np.maximum(linear[channel] * (gain * sensor.white_balance[channel]), 0)
        start = int(rng.integers(0, len(grain)))
        noise = np.take(grain, np.arange(start, start + len(value)), mode="wrap")
        value += noise * (sensor.read_noise + sensor.shot_noise * np.sqrt(np.minimum(value, 1)))
        result[:, channel] = _CURVE[np.clip(value * 1024, 0, len(_CURVE) - 1).astype(np.int32)]
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
