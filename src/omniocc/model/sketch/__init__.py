"""Sketch slot: which voxels are worth colouring."""

from typing import Protocol, runtime_checkable

from jaxtyping import Bool, Float
from torch import Tensor

from omniocc.camera import Rig
from omniocc.model.sketch.dense import Dense
from omniocc.model.sketch.omni import Omni
from omniocc.model.sketch.random import Random

__all__ = ["Dense", "Omni", "Random", "Sketch"]


@runtime_checkable
class Sketch(Protocol):
    """Chooses the candidate voxels of each sample."""

    def __call__(self, images: Float[Tensor, "B N 3 H W"], rigs: tuple[Rig, ...]) -> Bool[Tensor, "B X Y Z"]:
        """Candidates from RGB in [0, 1] and the rig of each sample."""
        ...
