"""The light of a scene, and the exposure of its cameras."""

from dataclasses import dataclass

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
        pools: light on the ground below street lamps, from `omniworld.render.lamp.lamp_pools`.
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
