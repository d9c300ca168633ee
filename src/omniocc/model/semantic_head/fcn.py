"""A small fully convolutional head (paper, section IV-D)."""

from typing import ClassVar

from jaxtyping import Float
from torch import Tensor, nn

from omniocc.bounds import Size
from omniocc.model.ops.padded import FeatureMaps


class FCN(nn.Module):
    """Classify pixels by 3x3 convolution, batch norm, ReLU and 1x1 convolution of the finest feature map.

    Args:
        in_channels: of the feature map.
        hidden_channels: of the 3x3 convolution.
        num_classes: logits per pixel; class 0 is the sky.
    """

    CLASSIFIES: ClassVar[bool] = True

    def __init__(self, in_channels: Size, hidden_channels: Size, num_classes: Size):
        super().__init__()
        self.layers = nn.Sequential(
            nn.Conv2d(in_channels, hidden_channels, 3, padding=1, bias=False),
            nn.BatchNorm2d(hidden_channels),
            nn.ReLU(),
            nn.Conv2d(hidden_channels, num_classes, 1),
        )

    def forward(self, features: FeatureMaps) -> Float[Tensor, "B N K h w"]:
        """Return logits at the resolution of the finest map."""
        finest = features[0]
        return self.layers(finest.flatten(0, 1)).unflatten(0, finest.shape[:2])
