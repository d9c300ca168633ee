"""Class tables: ids, names and colours; the twelve of the virtual world (the authors' legend; CARLA's palette)."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np


class SemanticClass(NamedTuple):
    """One class: its id in every label array, its name in tables, its colour in images."""

    id: int
    name: str
    rgb: tuple[int, int, int]


@dataclass(frozen=True)
class ClassTable:
    """The classes of a dataset: class 0 is free space, ids count from 0 without gaps.

    Attributes:
        rows: the classes in the order of their ids.

    Raises:
        ValueError: if ids are not 0, 1, 2 ... or two classes have one name.
    """

    rows: tuple[SemanticClass, ...]

    def __post_init__(self) -> None:
        """Check ids and names."""
        ids = [row.id for row in self.rows]
        if ids != list(range(len(ids))) or not 2 <= len(ids) <= UNKNOWN:
            raise ValueError(f"class ids {ids} must be 0 (free), 1, 2 ... and end before {UNKNOWN} (unknown)")
        if len(set(self.names)) != len(ids):
            raise ValueError(f"class names {list(self.names)} are not unique")

    @property
    def num_classes(self) -> int:
        """Return the number of classes, free included."""
        return len(self.rows)

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names in the order of the ids, free included."""
        return tuple(row.name for row in self.rows)

    @property
    def occupied(self) -> tuple[SemanticClass, ...]:
        """Return all classes but free."""
        return tuple(row for row in self.rows if row.id != FREE)

    @property
    def palette(self) -> np.ndarray:
        """Return the colour of every label, (256, 3) uint8 RGB; unknown is black."""
        palette = np.zeros((256, 3), dtype=np.uint8)
        palette[: len(self.rows)] = [row.rgb for row in self.rows]
        return palette


FREE = 0
UNKNOWN = 255

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
"""The classes of the virtual world."""
CLASS_TABLE = ClassTable(CLASSES)
NUM_CLASSES = len(CLASSES)
PALETTE = CLASS_TABLE.palette
"""RGB of the virtual world's classes by id, (256, 3) uint8; unknown is black."""
