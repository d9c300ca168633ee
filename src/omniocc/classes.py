"""Class tables, and the classes of the virtual world, with the names and colours of the paper (CARLA's palette)."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import UInt8

from rayiou.labels import FREE, NUM_CLASSES, UNKNOWN


class SemanticClass(NamedTuple):
    """One class: its id in label arrays, its name in tables and keys, its colour in images."""

    id: int
    name: str
    rgb: tuple[int, int, int]


@dataclass(frozen=True)
class ClassTable:
    """The classes of a dataset, with ids 0 .. N-1 in order; 0 is free space. The id 255, unknown, is not in the table.

    Raises:
        ValueError: naming the row that is wrong.
    """

    rows: tuple[SemanticClass, ...]

    def __post_init__(self) -> None:
        """Check the rows."""
        if not 2 <= len(self.rows) <= UNKNOWN:
            raise ValueError(f"a class table has {len(self.rows)} rows; it must have 2 to {UNKNOWN}")
        for index, row in enumerate(self.rows):
            if row.id != index:
                raise ValueError(
                    f"class '{row.name}' has id {row.id} in row {index}; ids must be 0, 1, 2, ... in order"
                )
            if not isinstance(row.name, str) or not row.name or not row.name.isprintable():
                raise ValueError(f"class {row.id} has the name {row.name!r}; names must be printable text")
            if self.names.count(row.name) > 1:
                raise ValueError(f"class {row.id} has the name '{row.name}'; names must be unique")
            if len(row.rgb) != 3 or not all(isinstance(value, int) and 0 <= value <= 255 for value in row.rgb):
                raise ValueError(f"class '{row.name}' has rgb {row.rgb}; it must be three whole numbers 0..255")

    @property
    def num_classes(self) -> int:
        """Return the number of classes, free included."""
        return len(self.rows)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Return the names in order of the ids."""
        return tuple(row.name for row in self.rows)

    @cached_property
    def occupied(self) -> tuple[int, ...]:
        """Return the ids of all classes but free."""
        return tuple(row.id for row in self.rows if row.id != FREE)

    @cached_property
    def palette(self) -> UInt8[np.ndarray, "256 3"]:
        """Return the colours (RGB) by id; ids beyond the table and 255 (unknown) are black."""
        palette = np.zeros((256, 3), dtype=np.uint8)
        palette[: self.num_classes] = [row.rgb for row in self.rows]
        return palette

    def to_dict(self) -> dict[str, dict[str, Any]]:
        """Return the table as plain data for JSON: name and rgb by id."""
        return {str(row.id): {"name": row.name, "rgb": list(row.rgb)} for row in self.rows}

    @classmethod
    def from_dict(cls, data: Mapping[str, Mapping[str, Any]]) -> "ClassTable":
        """Return the table from the data that `to_dict` returned.

        Raises:
            ValueError: naming the id or the row that is wrong.
        """
        try:
            rows = [SemanticClass(int(key), row["name"], tuple(row["rgb"])) for key, row in data.items()]
        except (AttributeError, KeyError, TypeError, ValueError) as error:
            raise ValueError(f"a class table must map ids to name and rgb, got {repr(data)[:200]}") from error
        return cls(tuple(sorted(rows, key=lambda row: row.id)))


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
WORLD_CLASSES = ClassTable(CLASSES)
"""The table of `CLASSES`."""
OCCUPANCY_CLASSES = ClassTable(
    (SemanticClass(0, "free", (255, 255, 255)), SemanticClass(1, "occupied", (110, 110, 130)))
)
"""Two classes, for points of a LiDAR without classes."""
ONE_CLASS = "free and occupied alone: scores are without classes"
"""What commands say of data and networks with these classes."""
assert WORLD_CLASSES.num_classes == NUM_CLASSES
