"""The first blocks of EfficientNet-Lite0 and feature pyramid."""

from typing import ClassVar, Literal

import torch
from jaxtyping import Float
from torch import Tensor, nn

from omniocc.bounds import Size
from omniocc.model.ops.backbone import FPN, Normalize, check_finest_first, on_padded
from omniocc.model.ops.efficientnet import LAST, MEAN, STD, encoder_with
from omniocc.model.ops.padded import FeatureMaps

STRIDES = [4, 8, 16]


class EfficientNetLite0(nn.Module):
    """Extract features by 11 of the 16 blocks of EfficientNet-Lite0 (Liu, 2020) and a feature pyramid.

    Lite0 is EfficientNet-B0 (Tan and Le, 2019) without squeeze-and-excitation and with ReLU6. Images are padded at the
    right and at the bottom to a multiple of 16 px.

    Args:
        weights: those of ImageNet, from the extra `pretrained`, or None for random ones.
        frozen: keep the encoder and its statistics of batch norm as they are; the feature pyramid is trained.
        channels: of the output maps.
        levels: strides of the output maps, some of 4, 8, 16 px.

    Raises:
        ValueError: if a level does not exist.
        UserError: if the weights are not installed.
    """

    PRETRAINED: ClassVar = ("weights",)

    def __init__(self, weights: Literal["imagenet"] | None, frozen: bool, channels: Size, levels: list[int]):
        super().__init__()
        if not levels or any(level not in STRIDES for level in levels):
            raise ValueError(f"levels are {levels}; they must be some of the strides {STRIDES}")
        check_finest_first(list(levels))
        self.channels, self.levels, self.frozen = channels, list(levels), frozen
        self.encoder = encoder_with(weights)
        if frozen:
            self.encoder.freeze()
        self.normalize = Normalize(self.encoder, MEAN, STD)
        self.fpn = FPN([LAST[stride] for stride in STRIDES], channels, [STRIDES.index(level) for level in levels])
        self.train()

    def train(self, mode: bool = True) -> "EfficientNetLite0":
        """Set the mode, but that of a frozen encoder, which stays in evaluation."""
        super().train(mode)
        self.encoder.train(mode and not self.frozen)
        return self

    def forward(self, images: Float[Tensor, "B N 3 H W"]) -> FeatureMaps:
        """Return feature maps of RGB in [0, 1], finest first."""
        with torch.set_grad_enabled(torch.is_grad_enabled() and not self.frozen):
            maps = on_padded(lambda padded: self.encoder(padded)[1:], self.normalize(images), STRIDES)
        return [level.unflatten(0, images.shape[:2]) for level in self.fpn(maps)]
