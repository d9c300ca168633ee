"""Some of many frames or scenes, evenly spaced."""

import numpy as np


def evenly_spaced(count: int, most: int) -> list[int]:
    """Return at most `most` of the numbers 0 to `count` - 1, evenly spaced, the first and the last included."""
    return sorted({round(value) for value in np.linspace(0, count - 1, min(count, most)).tolist()})
