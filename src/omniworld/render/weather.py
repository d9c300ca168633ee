"""Weather of a scene, with its light, air and cameras; drawn once per scene.

To add a weather, add it to `Weather` and its fraction of scenes to `_FRACTIONS`, and give it a light in `draw_light`.
"""

from dataclasses import replace
from typing import Literal, get_args

import numpy as np

from omniworld.render.light import Light, Sensor

Weather = Literal["clear", "overcast", "rain", "fog", "dusk"]
WEATHERS: tuple[str, ...] = get_args(Weather)
_FRACTIONS = (0.48, 0.17, 0.13, 0.08, 0.14)


def draw_weather(rng: np.random.Generator) -> str:
    """Draw a weather: clear in about half of all scenes, fog most rarely."""
    return WEATHERS[int(rng.choice(len(WEATHERS), p=_FRACTIONS))]


def draw_light(weather: str, rng: np.random.Generator) -> Light:
    """Draw sun, sky and air of one scene; raise ValueError if the weather does not exist."""
    if weather not in WEATHERS:
        raise ValueError(f"unknown weather {weather!r}; possible: {', '.join(WEATHERS)}")
    azimuth, height, depth, cover, haze = rng.uniform(0, 1, 5).tolist()
    shift = rng.uniform(0, 1, 2).astype(np.float32)
    if weather == "clear":
        return _clear(_direction(azimuth, 12 + 55 * height), depth, 0.08 + 0.5 * cover, shift, 300 + 600 * haze)
    if weather == "dusk":
        return _dusk(_direction(azimuth, 3 + 4 * height), depth, 0.1 + 0.5 * cover, shift, 250 + 300 * haze)
    light = _grey(0.55 + 0.25 * depth, 0.9 + 0.1 * cover, shift, 250 + 400 * haze)
    if weather == "rain":
        dim = 0.7
        return replace(
            light,
            zenith=dim * light.zenith,
            horizon=dim * light.horizon,
            bounce=0.5 * light.bounce,
            haze_m=70 + 110 * haze,
            wet=0.7 + 0.3 * cover,
            streaks=0.2 + 0.4 * height,
        )
    if weather == "fog":
        # The sky is as bright as the fog, so that no edge shows between them.
        return replace(light, zenith=1.04 * light.horizon, cloud_cover=0.0, haze_m=18 + 36 * haze, wet=0.25 * cover)
    return light


def draw_sensor(rng: np.random.Generator, light: Light) -> Sensor:
    """Draw cameras exposed for a grey road in this light, 10 % below to 12 % above; noisier after dark."""
    sky = 0.5 * (light.zenith + light.horizon)
    grey = float((light.sun * max(light.sun_direction[2], 0.3) + sky).mean())
    # At dusk a camera stays underexposed, and noisy.
    gain = (1.5 / grey) ** (0.72 if light.lamps else 1.0)
    dark = 1 + 2.5 * light.lamps
    return Sensor(
        exposure=float(rng.uniform(0.9, 1.12) * gain),
        white_balance=(1 + rng.uniform(-0.05, 0.05, 3)).astype(np.float32),
        vignette=float(rng.uniform(0.2, 0.4)),
        read_noise=float(rng.uniform(0.0015, 0.004) * dark),
        shot_noise=float(rng.uniform(0.008, 0.02) * dark),
    )


def _clear(direction: np.ndarray, depth: float, cover: float, shift: np.ndarray, haze_m: float) -> Light:
    elevation = np.arcsin(direction[2])
    low = float(np.clip((np.radians(45) - elevation) / np.radians(33), 0, 1))
    bounce = 0.16 * np.sin(elevation) * _color(1.0, 0.93, 0.85)
    return Light(
        sun_direction=direction,
        sun=(1.15 - 0.3 * low) * _color(1.0, 0.95 - 0.17 * low, 0.86 - 0.36 * low),
        zenith=(0.8 + 0.3 * depth) * _color(0.12, 0.23, 0.50),
        horizon=_color(0.46 + 0.14 * low, 0.54, 0.64 - 0.14 * low),
        bounce=bounce.astype(np.float32),
        glow=0.6,
        cloud_cover=cover,
        cloud_shift=shift,
        haze_m=haze_m,
    )


def _dusk(direction: np.ndarray, depth: float, cover: float, shift: np.ndarray, haze_m: float) -> Light:
    """Return the light at dusk: a last warm light from the side, a pale horizon, lamps and windows lit."""
    late = 0.9 - 0.6 * depth
    return Light(
        sun_direction=direction,
        sun=0.16 * late * _color(1.0, 0.55, 0.30),
        zenith=late * _color(0.045, 0.070, 0.150),
        horizon=late * _color(0.30, 0.20, 0.19),
        bounce=0.02 * _color(1.0, 0.95, 0.9),
        glow=0.9,
        cloud_cover=cover,
        cloud_shift=shift,
        haze_m=haze_m,
        lamps=0.6 + 0.4 * depth,
    )


def _grey(brightness: float, cover: float, shift: np.ndarray, haze_m: float) -> Light:
    sky = brightness * _color(0.93, 0.97, 1.0)
    return Light(
        sun_direction=_color(0.0, 0.0, 1.0),
        sun=_color(0.0, 0.0, 0.0),
        zenith=1.05 * sky,
        horizon=0.85 * sky,
        bounce=0.2 * sky,
        glow=0.0,
        cloud_cover=cover,
        cloud_shift=shift,
        haze_m=haze_m,
    )


def _direction(turn: float, elevation_deg: float) -> np.ndarray:
    azimuth, elevation = 2 * np.pi * turn, np.radians(elevation_deg)
    flat = np.cos(elevation)
    return _color(flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation))


def _color(red: float, green: float, blue: float) -> np.ndarray:
    return np.array([red, green, blue], np.float32)
