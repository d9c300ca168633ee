"""2D layers for panoramas, which wrap around in azimuth, and for images, which do not."""

from collections.abc import Sequence
from itertools import pairwise

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional as F

from omniocc.model.ops.efficientnet import FrozenLite0
from omniocc.model.ops.norm import group_norm
from omniocc.model.ops.padding import Residual, upsample_view, wrapped

STRIDE = 2
"""Of the features."""


class PanoramaConv(nn.Conv2d):
    """Convolve in 2D, keeping the size (odd kernels, stride 1), and wrapping around along the width if `wrap`."""

    def __init__(self, in_channels: int, out_channels: int, kernel_size: int, wrap: bool, bias: bool = True):
        super().__init__(in_channels, out_channels, kernel_size, bias=bias)
        self.wrap = wrap

    def forward(self, maps: Float[Tensor, "B C H W"]) -> Float[Tensor, "B D H W"]:
        """Return the convolved maps; zeros above and below, and at the sides unless it wraps."""
        border = self.kernel_size[0] // 2
        if not (self.wrap and border):
            return F.conv2d(maps, self.weight, self.bias, padding=border)
        return F.conv2d(wrapped(maps, border, -1), self.weight, self.bias, padding=(border, 0))


class UNet2d(nn.Module):
    """Apply residual blocks on a pyramid of halved maps, with added skips.

    A coarse pixel covers exactly 2x2 fine ones, so that flipping the input of a mirrored network flips the output, and,
    if it wraps, rolling the columns by a multiple of 2**(levels-1) rolls the output.

    Args:
        channels: of each level, finest first; multiples of 8.
        blocks: residual blocks on each level, on the way down and again on the way up.
        wrap: whether the left and right edge are neighbours.
    """

    def __init__(self, channels: list[int], blocks: int, wrap: bool):
        super().__init__()
        self.wrap = wrap
        pairs = list(pairwise(channels))
        self.encoder = nn.ModuleList(_blocks(count, blocks, wrap) for count in channels)
        self.down = nn.ModuleList(nn.Conv2d(fine, coarse, 2, stride=2) for fine, coarse in pairs)
        self.up = nn.ModuleList(nn.Conv2d(coarse, fine, 1) for fine, coarse in pairs)
        self.decoder = nn.ModuleList(_blocks(fine, blocks, wrap) for fine, _ in pairs)

    def forward(
        self, maps: Float[Tensor, "B C H W"], added: Sequence[Float[Tensor, "B _ _ _"]] = ()
    ) -> Float[Tensor, "B C H W"]:
        """Return maps of the same size and channels.

        Args:
            maps: the input.
            added: maps of every level, finest first, that are added where it begins; none: nothing is added.

        Raises:
            ValueError: if it wraps and the width cannot be halved often enough.
        """
        factor = 2 ** len(self.down)
        if self.wrap and maps.shape[-1] % factor:
            raise ValueError(f"{len(self.down) + 1} levels need widths in multiples of {factor}, not {maps.shape[-1]}")
        skips = []
        maps = self.encoder[0](maps + added[0] if added else maps)
        for level, (down, block) in enumerate(zip(self.down, list(self.encoder)[1:], strict=True), 1):
            skips.append(maps)
            odd = [size % 2 for size in maps.shape[-2:]]
            maps = down(F.pad(maps, (0, odd[1], 0, odd[0])) if any(odd) else maps)
            maps = block(maps + added[level] if added else maps)
        for up, block, skip in reversed(list(zip(self.up, self.decoder, skips, strict=True))):
            maps = block(skip + upsample_view(up(maps), skip.shape[-2:], (False, self.wrap)))
        return maps


def _blocks(channels: int, count: int, wrap: bool) -> nn.Sequential:
    return nn.Sequential(*(Residual(PanoramaConv(channels, channels, 3, wrap, bias=False)) for _ in range(count)))


class FeatureNet(nn.Module):
    """Extract features at half or all of the size of the images, by one network for all cameras.

    The stem covers 4x4 px around the centre of every 2x2 block, so that features are exactly at their `grid_sample`
    coordinates, and mirrored images give mirrored features if the kernels are mirrored too.

    Args:
        channels: of each level, finest first, the first at half the image size; multiples of 8.
        out_channels: of the features.
        extra_channels: of input maps besides the colours.
        stride: image pixels per feature along each side, 1 or 2; at 1 each pixel of the finest level gives four.
        pretrained: frozen features that are added to those of every level; None: nothing is added.

    Raises:
        ValueError: for another stride, or too many levels for the frozen features.
    """

    def __init__(
        self,
        channels: list[int],
        out_channels: int,
        extra_channels: int = 0,
        stride: int = STRIDE,
        pretrained: FrozenLite0 | None = None,
    ):
        super().__init__()
        if stride not in (1, STRIDE):
            raise ValueError(f"the stride of the features is {stride}; it must be 1 or {STRIDE}")
        self.enlarge = nn.PixelShuffle(STRIDE) if stride == 1 else nn.Identity()
        self.stem = nn.Conv2d(3 + extra_channels, channels[0], 4, stride=STRIDE, padding=1, bias=False)
        self.norm = group_norm(channels[0])
        self.net = UNet2d(channels, blocks=1, wrap=False)
        self.out = nn.Conv2d(channels[0], out_channels * (STRIDE // stride) ** 2, 1)
        self.pretrained = pretrained
        if pretrained is not None:
            self.added = nn.ModuleList(map(_adding_nothing, pretrained.channels(len(channels)), channels))

    def forward(
        self, images: Float[Tensor, "B N 3 H W"], extra: Float[Tensor, "B N E H W"] | None = None
    ) -> Float[Tensor, "B N C _ _"]:
        """Return features of images; raise ValueError unless their height and width are even."""
        if images.shape[-2] % STRIDE or images.shape[-1] % STRIDE:
            raise ValueError(f"images are {images.shape[-1]}x{images.shape[-2]} px; width and height must be even")
        colors = (images - 0.45) / 0.25
        inputs = colors if extra is None else torch.cat([colors, extra], 2)
        flat = inputs.flatten(0, 1).contiguous(memory_format=torch.channels_last)
        given = () if self.pretrained is None else self.pretrained(images, len(self.added))
        added = [add(maps) for add, maps in zip(self.added, given, strict=True)] if given else ()
        maps = self.net(torch.relu(self.norm(self.stem(flat))), added)
        return self.enlarge(self.out(maps)).unflatten(0, images.shape[:2])


def _adding_nothing(inputs: int, outputs: int) -> nn.Sequential:
    """Return layers whose maps are 0 at first, so that a network that was trained without them stays as it is."""
    norm = group_norm(outputs)
    nn.init.zeros_(norm.weight)
    return nn.Sequential(nn.Conv2d(inputs, outputs, 1, bias=False), norm)


def window_argmax(
    logits: Float[Tensor, "B D h w"], radius: int
) -> tuple[Float[Tensor, "B h w"], Float[Tensor, "B h w"]]:
    """Return a fractional index and its confidence.

    The index is the mean, weighted by probability, of the spheres up to `radius` from the peak, where three neighbours
    have the most probability. Unlike the mean over all spheres it stays on one surface when two are likely. The
    confidence is the probability of the window.
    """
    probability = logits.float().softmax(1)
    padded = F.pad(probability.detach(), (0, 0, 0, 0, 1, 1))
    peak = (padded[:, :-2] + padded[:, 1:-1] + padded[:, 2:]).argmax(1, keepdim=True)
    offsets = torch.arange(-radius, radius + 1, device=logits.device).view(1, -1, 1, 1)
    spheres = peak + offsets
    nearest = spheres.clamp(0, logits.shape[1] - 1)
    window = probability.gather(1, nearest) * (nearest == spheres)
    mass = window.sum(1)
    return (window * spheres).sum(1) / mass.clamp(min=1e-6), mass
