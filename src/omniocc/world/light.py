"""What lights a scene, and how the cameras answer: drawn once per scene."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Light:
    """Sun, sky and air. Colours are linear RGB, (3,) float32; white paper in full sun is about 1 before exposure.

    Attributes:
        sun_direction: unit vector from the ground to the sun, world frame.
        sun: light on a surface that faces the sun.
        zenith: colour of the sky overhead; with `horizon` also what lights the shadows.
        horizon: colour of the sky at the horizon, and of haze.
        bounce: light from the ground on surfaces that face down.
        glow: brightness of the sky around the sun.
        cloud_cover: share of the sky under clouds, 0..1.
        cloud_shift: (2,) where in the pattern of clouds this scene lies.
        haze_m: distance at which haze hides 63 % of a thing.
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


@dataclass(frozen=True)
class Sensor:
    """How all cameras of a scene turn light into numbers.

    Attributes:
        exposure: factor on linear light.
        white_balance: (3,) factors on red, green and blue.
        vignette: share of light lost at the rim of the lens.
        read_noise: standard deviation at black, of full scale in linear light.
        shot_noise: standard deviation at full scale.
    """

    exposure: float
    white_balance: np.ndarray
    vignette: float
    read_noise: float
    shot_noise: float


def draw_light(rng: np.random.Generator) -> Light:
    """A clear day at some hour (two of three scenes) or an overcast one."""
    azimuth, clear = rng.uniform(0, 2 * np.pi), rng.random() < 0.67
    elevation = np.radians(rng.uniform(20, 65) if clear else rng.uniform(60, 85))
    direction = _color(np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation))
    shift, haze_m = rng.uniform(0, 1, 2).astype(np.float32), float(rng.uniform(300, 900))
    if not clear:
        sky = rng.uniform(0.55, 0.8) * _color(0.93, 0.97, 1.0)
        return Light(direction, 0.45 * sky, 0.85 * sky, 0.8 * sky, 0.25 * sky, 0.0, 0.95, shift, 0.8 * haze_m)
    low = float(np.clip((np.radians(45) - elevation) / np.radians(30), 0, 1))
    sun = (1.15 - 0.25 * low) * _color(1.0, 0.95 - 0.14 * low, 0.86 - 0.30 * low)
    zenith = rng.uniform(0.8, 1.1) * _color(0.12, 0.23, 0.50)
    horizon = _color(0.46 + 0.12 * low, 0.54, 0.64 - 0.10 * low)
    bounce = 0.16 * np.sin(elevation) * _color(1.0, 0.93, 0.85)
    return Light(
        direction, sun, zenith, horizon, bounce.astype(np.float32), 0.6, float(rng.uniform(0.1, 0.6)), shift, haze_m
    )


def draw_sensor(rng: np.random.Generator, light: Light) -> Sensor:
    """Exposed for a grey road in this light, give or take a third."""
    ambient = 0.5 * (light.zenith + light.horizon)
    grey = float((light.sun * max(light.sun_direction[2], 0.3) + ambient).mean())
    return Sensor(
        exposure=float(rng.uniform(0.85, 1.15) * 1.5 / grey),
        white_balance=(1 + rng.uniform(-0.05, 0.05, 3)).astype(np.float32),
        vignette=float(rng.uniform(0.2, 0.4)),
        read_noise=float(rng.uniform(0.0015, 0.004)),
        shot_noise=float(rng.uniform(0.008, 0.02)),
    )


def ambient(light: Light, up: np.ndarray) -> np.ndarray:
    """(3, R) light from sky and ground on surfaces whose normals have the upward component `up` (R,)."""
    sky = 0.5 * (light.zenith + light.horizon)
    share = 0.5 + 0.5 * up
    return sky[:, None] * share + light.bounce[:, None] * (1 - share)


def develop(linear: np.ndarray, sensor: Sensor, falloff: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Linear light (3, P) to RGB (P, 3) uint8; `falloff` (P,) is 0 on the axis and 1 at the rim; `rng` draws noise."""
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


def _color(red: float, green: float, blue: float) -> np.ndarray:
    return np.array([red, green, blue], np.float32)


def _tone_curve() -> np.ndarray:
    value = np.arange(4096) / 1024
    shoulder = value * (1 + value / 9) / (1 + 0.85 * value) * 1.08
    encoded = np.where(shoulder < 0.0031308, 12.92 * shoulder, 1.055 * np.maximum(shoulder, 1e-6) ** (1 / 2.4) - 0.055)
    return np.clip(np.rint(255 * encoded), 0, 255).astype(np.uint8)


_CURVE = _tone_curve()
_GRAIN: list[np.ndarray] = []


def _grain() -> np.ndarray:
    if not _GRAIN:
        _GRAIN.append(np.random.default_rng(17).standard_normal(1 << 19).astype(np.float32))
    return _GRAIN[0]
