"""Height of the land: gentle hills under the streets, higher ones on the horizon."""

from dataclasses import dataclass

import numpy as np

_WAVES = 4
_HORIZON_START_M = 260.0


@dataclass(frozen=True)
class Terrain:
    """Height as a sum of plane waves, exact and smooth, with hills added more than 260 m from the world's origin.

    Attributes:
        wave_vector: (W, 2) of each wave, radians per metre.
        amplitude_m: (W,) of each wave.
        phase_rad: (W,) of each wave at the world's origin.
        horizon_m: mean height of these hills 560 m from the origin; they rise evenly from 260 m on.
    """

    wave_vector: np.ndarray
    amplitude_m: np.ndarray
    phase_rad: np.ndarray
    horizon_m: float

    def height(self, x_m: np.ndarray | float, y_m: np.ndarray | float) -> np.ndarray:
        """Return the height (...) float64 at world positions (...)."""
        x_m, y_m = np.asarray(x_m, float), np.asarray(y_m, float)
        angle = x_m[..., None] * self.wave_vector[:, 0] + y_m[..., None] * self.wave_vector[:, 1] + self.phase_rad
        outside = np.clip((np.hypot(x_m, y_m) - _HORIZON_START_M) / 300, 0, None)
        hills = self.horizon_m * outside * (1 + 0.5 * np.sin(5 * np.arctan2(y_m, x_m)))
        return np.asarray((np.sin(angle) * self.amplitude_m).sum(-1) + hills)

    def points(self, xy_m: np.ndarray, above_m: np.ndarray | float = 0.0) -> np.ndarray:
        """Return (..., 3) points `above_m` over the land at world positions (..., 2)."""
        return np.concatenate([xy_m, (self.height(xy_m[..., 0], xy_m[..., 1]) + above_m)[..., None]], -1)


def draw(rng: np.random.Generator, slope: float, horizon_m: float) -> Terrain:
    """Draw hills whose steepest slopes come near `slope` (rise over run)."""
    azimuth = rng.uniform(0, 2 * np.pi) + np.arange(_WAVES) * (np.pi / _WAVES) + rng.uniform(-0.2, 0.2, _WAVES)
    length_m = rng.uniform(110, 320, _WAVES)
    wave_number = 2 * np.pi / length_m
    fraction = rng.dirichlet(np.full(_WAVES, 3.0))
    amplitude_m = 1.35 * slope * fraction / wave_number
    direction = np.stack([np.cos(azimuth), np.sin(azimuth)], 1)
    return Terrain(direction * wave_number[:, None], amplitude_m, rng.uniform(0, 2 * np.pi, _WAVES), horizon_m)
