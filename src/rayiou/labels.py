"""Ids in arrays of labels that have the same meaning everywhere."""

import numpy as np

FREE = 0
"""Id of free space."""
UNKNOWN = 255
"""Id of unlabelled cells and pixels, which is no class."""
NUM_CLASSES = 12
"""Number of classes where none is given, free included."""
MOST_SHOWN = 8
"""Wrong ids that messages name."""


def ids_beyond(labels: np.ndarray, num_classes: int, first: int = FREE) -> list[int | float]:
    """Return some of the ids in labels that are neither 255 (unknown) nor whole numbers from `first` to the last class.

    Labels are of any shape and type: negative numbers, fractions and nan are no ids either.
    """
    wrong = ~((labels >= first) & (labels < num_classes)) & (labels != UNKNOWN)
    if labels.dtype.kind == "f":
        wrong |= labels != np.floor(labels)
    return np.unique(labels[wrong])[:MOST_SHOWN].tolist() if wrong.any() else []
