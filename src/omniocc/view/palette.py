"""Colours of classes, from the table of classes that goes with the labels."""

from collections.abc import Sequence

import numpy as np

from omniocc.classes import FREE, SemanticClass
from omniocc.view.canvas import legend


def palette_of(classes: Sequence[SemanticClass]) -> np.ndarray:
    """Return RGB by class id, (256, 3) uint8; ids without a class, such as 255 for unknown, are black."""
    palette = np.zeros((256, 3), dtype=np.uint8)
    for entry in classes:
        palette[entry.id] = entry.rgb
    return palette


def class_legend(classes: Sequence[SemanticClass], width_px: int) -> np.ndarray:
    """Return a legend (height, width_px, 3) with names and colours of all classes but free."""
    return legend([(entry.name, entry.rgb) for entry in classes if entry.id != FREE], width_px)
