"""ResNet and feature pyramid."""

import logging
from collections.abc import Callable, Sequence
from typing import ClassVar, Literal

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional as F
from transformers import ResNetConfig, ResNetModel

from omniocc.bounds import Count, Size
from omniocc.model.ops.backbone import FPN, Normalize, check_finest_first, load_or_random, require_equal
from omniocc.model.ops.multilinear import corners, sum_samples
from omniocc.model.ops.padded import FeatureMaps

log = logging.getLogger(__name__)

Pair = tuple[int, int]
Operator = Callable[[Tensor, Tensor, Tensor, Tensor, Pair, Pair], Tensor]
STRIDES = [4, 8, 16, 32]
COMPARED = ("layer_type", "embedding_size", "hidden_sizes", "depths")


def sampled_convolution(
    maps: Float[Tensor, "B C H W"],
    weight: Float[Tensor, "D C k l"],
    offsets: Float[Tensor, "B 2*k*l h w"],
    mask: Float[Tensor, "B k*l h w"],
    stride: Pair,
    padding: Pair,
) -> Float[Tensor, "B D h w"]:
    """Convolve with taps moved by `offsets` and scaled by `mask`; bilinear between pixels, zeros outside.

    Args:
        maps: input of the convolution.
        weight: the kernel.
        offsets: of each tap in pixels: (row, column) of one tap after another, in row-major order.
        mask: factor of each tap.
        stride: along rows and columns, px.
        padding: where the kernel begins, px before the first row and column.
    """
    batch, channels, rows, columns = maps.shape
    positions = _tap_positions(weight.shape[2:], offsets, stride, padding)
    found = corners(positions, mask.permute(0, 2, 3, 1), (rows, columns), (False, False))
    table = F.pad(maps.permute(0, 2, 3, 1), (0, 0, 1, 1, 1, 1)).reshape(-1, channels)
    images = torch.arange(batch, dtype=torch.int32, device=maps.device)[:, None, None, None]
    row = found.row + images * ((rows + 2) * (columns + 2))
    samples = sum_samples(table, row.reshape(-1, 1), found.weights.flatten(0, 3)[:, None], found.steps)
    taps = samples.view(*row.shape[:3], -1)
    return F.linear(taps, weight.permute(0, 2, 3, 1).flatten(1)).permute(0, 3, 1, 2)


def _tap_positions(
    kernel: torch.Size, offsets: Float[Tensor, "B _ h w"], stride: Pair, padding: Pair
) -> Float[Tensor, "2 B h w taps"]:
    """Return (row, column) of every tap of every output pixel."""
    taps = torch.cartesian_prod(*(torch.arange(size, device=offsets.device) for size in kernel))
    moved = offsets.unflatten(1, (-1, 2)).permute(2, 0, 3, 4, 1)
    axes = []
    for axis, (size, step, pad) in enumerate(zip(offsets.shape[2:], stride, padding, strict=True)):
        first = torch.arange(size, device=offsets.device) * step - pad
        first = first[:, None, None] if axis == 0 else first[:, None]
        axes.append(moved[axis] + (first + taps[:, axis]))
    return torch.stack(axes)


def _torchvision() -> Operator | None:
    try:
        from torchvision.ops import deform_conv2d
    except ImportError:
        return None
    except RuntimeError as error:  # it was built for another torch
        log.warning("torchvision does not fit torch, deformable convolution runs without it: %s", error)
        return None
    return lambda maps, weight, offsets, mask, stride, padding: deform_conv2d(
        maps, offsets, weight, None, stride, padding, mask=mask
    )


OPERATORS: list[Operator] = [operator for operator in (_torchvision(), sampled_convolution) if operator is not None]


class DeformableConv2d(nn.Module):
    """Convolve deformably (DCNv2, Zhu et al., 2019) with the kernel of a convolution, whose result it has at first.

    A convolution of the same kernel size predicts an offset and a factor 2 sigmoid(.) for each tap. Its weights are
    zero initially. Sampling runs in float32, by torchvision's operator where installed.

    Args:
        conv: a convolution; ValueError if it has bias, groups or dilation.
    """

    def __init__(self, conv: nn.Conv2d):
        super().__init__()
        if conv.bias is not None or conv.groups != 1 or conv.dilation != (1, 1) or isinstance(conv.padding, str):
            raise ValueError(f"{conv} cannot be made deformable: it must have no bias, groups or dilation")
        self.stride: Pair = conv.stride  # type: ignore[assignment]
        self.padding: Pair = conv.padding  # type: ignore[assignment]
        self.weight = conv.weight
        taps = conv.kernel_size[0] * conv.kernel_size[1]
        self.taps = nn.Conv2d(conv.in_channels, 3 * taps, conv.kernel_size, self.stride, self.padding)  # type: ignore[arg-type]
        nn.init.zeros_(self.taps.weight)
        nn.init.zeros_(self.taps.bias)  # type: ignore[arg-type]

    def forward(self, maps: Float[Tensor, "B C H W"]) -> Float[Tensor, "B D h w"]:
        """Return the convolved maps."""
        found = self.taps(maps)
        split = found.shape[1] // 3 * 2
        dtype = torch.promote_types(maps.dtype, torch.float32)
        offsets, mask = found[:, :split].to(dtype), 2 * found[:, split:].to(dtype).sigmoid()
        return OPERATORS[0](maps.to(dtype), self.weight, offsets, mask, self.stride, self.padding)


class ResNet(nn.Module):
    """Extract features by the ResNet of the package transformers and a feature pyramid.

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
        embedding_size: Size,
        hidden_sizes: list[Size],
        depths: list[Count],
        weights: str | None,
        channels: Size,
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


def build_resnet(config: ResNetConfig, weights: str | None) -> ResNetModel:
    """Return a ResNet with the named weights, or with random ones (see `load_or_random`).

    Raises:
        ValueError: if the weights belong to a network of other sizes.
    """

    def load(name: str, local: bool) -> ResNetModel:
        model = ResNetModel.from_pretrained(name, local_files_only=local)
        require_equal(model.config, config, COMPARED, name)
        return model

    return load_or_random(weights, load, lambda: ResNetModel(config))


def make_deformable(stage: nn.Module) -> None:
    """Replace every 3x3 convolution of a stage by a deformable one that starts out equal."""
    for parent in list(stage.modules()):
        for name, layer in list(parent.named_children()):
            if isinstance(layer, nn.Conv2d) and layer.kernel_size == (3, 3):
                setattr(parent, name, DeformableConv2d(layer))
