"""ResNet and feature pyramid."""

from collections.abc import Sequence
from typing import ClassVar, Literal

from jaxtyping import Float
from torch import Tensor, nn
from transformers import ResNetConfig

from omniocc.model.ops.backbone.fpn import FPN, check_finest_first
from omniocc.model.ops.backbone.pretrained import Normalize, build_resnet
from omniocc.model.ops.deformable_conv import DeformableConv2d
from omniocc.model.ops.padded import FeatureMaps

STRIDES = [4, 8, 16, 32]


class ResNet(nn.Module):
    """Extract features by a residual network of transformers and a feature pyramid.

    Args:
        layer_type: blocks of two 3x3 convolutions (`basic`), or of a 3x3 convolution between two 1x1 (`bottleneck`).
        embedding_size: channels after the stem.
        hidden_sizes: channels of the four stages.
        depths: blocks of the four stages.
        weights: pretrained weights on the Hugging Face hub, or None; if not available, warn and use random ones.
        channels: of the output maps.
        levels: strides of the output maps, some of 4, 8, 16, 32 px.
        deformable_stages: stages, of 1 to 4, whose 3x3 convolutions become deformable with the same weights.

    Raises:
        ValueError: if a level or stage does not exist or the weights have other sizes.
    """

    PRETRAINED: ClassVar = ("weights",)

    def __init__(
        self,
        layer_type: Literal["basic", "bottleneck"],
        embedding_size: int,
        hidden_sizes: list[int],
        depths: list[int],
        weights: str | None,
        channels: int,
        levels: list[int],
        deformable_stages: Sequence[int] = (),
    ):
        super().__init__()
        if not levels or any(level not in STRIDES for level in levels):
            raise ValueError(f"levels are {levels}; they must be some of the strides {STRIDES}")
        check_finest_first(list(levels))
        if any(stage not in (1, 2, 3, 4) for stage in deformable_stages):
            raise ValueError(f"deformable_stages are {list(deformable_stages)}; they must be some of 1, 2, 3, 4")
        self.channels, self.levels = channels, list(levels)
        config = ResNetConfig(
            layer_type=layer_type, embedding_size=embedding_size, hidden_sizes=hidden_sizes, depths=depths
        )
        self.encoder = build_resnet(config, weights)
        self.normalize = Normalize(self.encoder)
        for stage in deformable_stages:
            make_deformable(self.encoder.encoder.stages[stage - 1])
        self.fpn = FPN(hidden_sizes, channels, [STRIDES.index(level) for level in levels])

    def forward(self, images: Float[Tensor, "B N 3 H W"]) -> FeatureMaps:
        """Return feature maps of RGB in [0, 1], finest first."""
        stages = self.encoder(self.normalize(images), output_hidden_states=True).hidden_states[1:]
        return [level.unflatten(0, images.shape[:2]) for level in self.fpn(list(stages))]


def make_deformable(stage: nn.Module) -> None:
    """Replace every 3x3 convolution of a stage by a deformable one that starts out equal."""
    for parent in list(stage.modules()):
        for name, layer in list(parent.named_children()):
            if isinstance(layer, nn.Conv2d) and layer.kernel_size == (3, 3):
                setattr(parent, name, DeformableConv2d(layer))
