"""Refiner slot: reasoning on the whole grid."""

from typing import Protocol, runtime_checkable

from jaxtyping import Float
from torch import Tensor

from omniocc.model.refiner.attention import Attention
from omniocc.model.refiner.channel_to_height import ChannelToHeight
from omniocc.model.refiner.conv import Conv
from omniocc.model.refiner.none import NoRefiner
from omniocc.model.refiner.unet import UNet

__all__ = ["Attention", "ChannelToHeight", "Conv", "NoRefiner", "Refiner", "UNet"]


@runtime_checkable
class Refiner(Protocol):
    """Maps voxel features to voxel features.

    Attributes:
        channels: of the volume it returns.
    """

    channels: int

    def __call__(self, volume: Float[Tensor, "B C X Y Z"]) -> Float[Tensor, "B D X Y Z"]:
        """A volume of the same shape with `channels` channels."""
        ...
