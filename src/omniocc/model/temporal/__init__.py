"""Temporal slot: what past frames add."""

from typing import Protocol, runtime_checkable

from jaxtyping import Float
from torch import Tensor

from omniocc.model.temporal.none import NoTemporal

__all__ = ["NoTemporal", "Temporal"]


@runtime_checkable
class Temporal(Protocol):
    """Fuses the volumes of a window of frames into one.

    Attributes:
        frames: length of the window it wants, the newest frame included.
    """

    frames: int

    def __call__(
        self, volumes: list[Float[Tensor, "B C X Y Z"]], world_from_ego: Float[Tensor, "B T 4 4"]
    ) -> Float[Tensor, "B C X Y Z"]:
        """Volumes oldest first, each in the ego frame of its time -> one in the newest frame's."""
        ...
