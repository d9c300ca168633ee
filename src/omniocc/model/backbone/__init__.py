"""Backbone slot: image features."""

from typing import Protocol, runtime_checkable

from jaxtyping import Float
from torch import Tensor

from omniocc.model.backbone.resnet import ResNet
from omniocc.model.backbone.transformers import Transformers

__all__ = ["Backbone", "ResNet", "Transformers"]


@runtime_checkable
class Backbone(Protocol):
    """Turns camera images into a pyramid of feature maps.

    Attributes:
        channels: of every map.
    """

    channels: int

    def __call__(self, images: Float[Tensor, "B N 3 H W"]) -> list[Float[Tensor, "B N C _ _"]]:
        """RGB in [0, 1] -> maps that each cover the whole image, finest first."""
        ...
