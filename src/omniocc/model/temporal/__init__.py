"""Temporal slot: what past frames add."""

from typing import Protocol, runtime_checkable

from jaxtyping import Bool, Float
from torch import Tensor

from omniocc.model.temporal.mean import Mean
from omniocc.model.temporal.none import NoTemporal
from omniocc.model.temporal.recurrent import Recurrent

__all__ = ["Mean", "NoTemporal", "Recurrent", "Temporal"]


@runtime_checkable
class Temporal(Protocol):
    """Fuses the volumes of a window of frames into one.

    Attributes:
        frames: length of the window it wants, the newest frame included.
        history_gradient: whether training reaches the network also through the past frames.
    """

    frames: int
    history_gradient: bool

    def __call__(
        self,
        volumes: list[Float[Tensor, "B C X Y Z"]],
        world_from_ego: Float[Tensor, "B T 4 4"],
        exists: Bool[Tensor, "B T"],
    ) -> Float[Tensor, "B C X Y Z"]:
        """Volumes oldest first, each in the ego frame of its time -> one in the newest frame's.

        The newest frame always exists; volumes of those that do not hold any finite numbers, their poses any pose.
        """
        ...
