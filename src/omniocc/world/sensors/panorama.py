"""Rays of the panorama of ranges around the ego."""

import numpy as np


def panorama_directions(width: int, height: int, top_deg: float, bottom_deg: float) -> np.ndarray:
    """Return (3, height * width) float32 unit rays of an equirectangular image (see docs/design.md, frames)."""
    azimuth = np.pi - (np.arange(width) + 0.5) * (2 * np.pi / width)
    elevation = np.radians(top_deg - (np.arange(height) + 0.5) * ((top_deg - bottom_deg) / height))
    elevation, azimuth = (grid.ravel() for grid in np.meshgrid(elevation, azimuth, indexing="ij"))
    flat = np.cos(elevation)
    return np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)]).astype(np.float32)
