"""The twelve classes: ids, names and colours (the authors' legend; CARLA's palette)."""

from typing import NamedTuple

import numpy as np


class SemanticClass(NamedTuple):
    """One class: its id in every label array, its name in tables, its colour in pictures."""

    id: int
    name: str
    rgb: tuple[int, int, int]


CLASSES: tuple[SemanticClass, ...] = (
    SemanticClass(0, "Free", (255, 255, 255)),
    SemanticClass(1, "Road", (128, 64, 128)),
    SemanticClass(2, "Sidewalk", (244, 35, 232)),
    SemanticClass(3, "Ground", (81, 0, 81)),
    SemanticClass(4, "Building", (70, 70, 70)),
    SemanticClass(5, "Wall", (156, 102, 102)),
    SemanticClass(6, "Vegetation", (107, 142, 35)),
    SemanticClass(7, "Vehicle", (142, 0, 0)),
    SemanticClass(8, "Other", (55, 90, 80)),
    SemanticClass(9, "Pole", (153, 153, 153)),
    SemanticClass(10, "Pedestrian", (220, 20, 60)),
    SemanticClass(11, "Roadline", (157, 234, 50)),
)
NUM_CLASSES = len(CLASSES)
FREE = 0
UNKNOWN = 255

PALETTE = np.zeros((256, 3), dtype=np.uint8)
"""RGB by class id; unknown is black."""
PALETTE[:NUM_CLASSES] = [row.rgb for row in CLASSES]
