"""Lifter slot: from image features to voxel features."""

from typing import Protocol, runtime_checkable

from jaxtyping import Bool, Float
from torch import Tensor

from omniocc.camera import Rig
from omniocc.model.lifter.coarse_coloring import CoarseColoring
from omniocc.model.lifter.coloring import Coloring
from omniocc.model.lifter.lift_splat import LiftSplat
from omniocc.model.lifter.pillar import Pillar

__all__ = ["CoarseColoring", "Coloring", "GuessesRanges", "LiftSplat", "Lifter", "Pillar"]


@runtime_checkable
class Lifter(Protocol):
    """Gives the candidate voxels of one frame their features.

    Attributes:
        channels: of the volume.
    """

    channels: int

    def __call__(
        self, features: list[Float[Tensor, "B N C _ _"]], candidates: Bool[Tensor, "B X Y Z"], rigs: tuple[Rig, ...]
    ) -> Float[Tensor, "B D X Y Z"]:
        """Feature maps that each cover the whole image, finest first -> features of all voxels, ego frame."""
        ...


@runtime_checkable
class GuessesRanges(Protocol):
    """A lifter whose way leads over a distribution of range for every pixel."""

    def range_logits(self, features: list[Float[Tensor, "B N C _ _"]]) -> Float[Tensor, "B N D h w"]:
        """Of bins of range along the rays, at the coarsest map's size."""
        ...
