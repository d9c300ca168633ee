"""Class ids as metrics see them: which are valid, which is free, which is ignored, and their names."""

from collections.abc import Sequence
from dataclasses import dataclass

from jaxtyping import Shaped, UInt8
from torch import Tensor

from rayiou.checks import check_labels


@dataclass(frozen=True)
class ClassIds:
    """The classes of a metric.

    Attributes:
        num_classes: number of classes, free included.
        free: id of free space.
        ignored: id of unknown cells in the truth, beyond the classes.
        names: of the classes by id; None for the ids.

    Raises:
        ValueError: if the ids do not fit into uint8, the ignored one is a class, or names are missing or repeated.
    """

    num_classes: int
    free: int
    ignored: int
    names: Sequence[str] | None = None

    def __post_init__(self) -> None:
        if not 2 <= self.num_classes <= 255:
            raise ValueError(f"num_classes must be 2..255, got {self.num_classes}")
        if not 0 <= self.free < self.num_classes:
            raise ValueError(f"free_index must be 0..{self.num_classes - 1}, got {self.free}")
        if not self.num_classes <= self.ignored <= 255:
            raise ValueError(f"ignore_index must be {self.num_classes}..255, beyond the classes, got {self.ignored}")
        names = self.names
        if names is not None and (len(names) != self.num_classes or len(set(names)) != len(names)):
            raise ValueError(f"class_names must be {self.num_classes} different names, got {list(names)}")

    @property
    def occupied(self) -> dict[int, str]:
        """Return the names of all classes but free by id."""
        names = list(map(str, range(self.num_classes))) if self.names is None else self.names
        return {label: name for label, name in enumerate(names) if label != self.free}

    def check(
        self, name: str, labels: Shaped[Tensor, "B *grid"], shape: tuple[int, ...], truth: bool
    ) -> UInt8[Tensor, "B *grid"]:
        """Return ids (B, *shape) as uint8; those of the truth may be `ignored`.

        Raises:
            ValueError: with `name`, for a wrong shape, type or id.
        """
        return check_labels(name, labels, shape, self.num_classes, self.ignored if truth else None)
