"""Weights of the Hugging Face hub, if available, normalisation and padding of images, and a feature pyramid."""

import logging
import os
import urllib.error
import urllib.request
from collections.abc import Callable, Iterable, Sequence
from typing import TYPE_CHECKING, TypeVar

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional as F

from omniocc.errors import UserError, first_line

if TYPE_CHECKING:  # its import takes half a second
    from transformers import PretrainedConfig

log = logging.getLogger(__name__)

PROBE_TIMEOUT_S = 3.0
FILES = (".pt", ".pth", ".bin", ".ckpt", ".safetensors")
ONEDNN_BLOCK = 16
"""Channels that oneDNN computes at once on CPUs with AVX-512."""
MEAN = (0.485, 0.456, 0.406)
STD = (0.229, 0.224, 0.225)

Network = TypeVar("Network", bound=nn.Module)


class Normalize(nn.Module):
    """Subtract a mean from RGB in [0, 1] and divide by a deviation.

    Args:
        encoder: the network that gets the images. Channels last in memory are faster, but not safe for all networks.
        mean: of each colour; that of ImageNet unless told.
        std: the same of the deviation.
    """

    mean: Tensor
    std: Tensor

    def __init__(self, encoder: nn.Module, mean: Sequence[float] = MEAN, std: Sequence[float] = STD):
        super().__init__()
        self.memory_format = torch.channels_last if survives_channels_last(encoder) else torch.contiguous_format
        self.register_buffer("mean", torch.tensor(mean).view(3, 1, 1), persistent=False)
        self.register_buffer("std", torch.tensor(std).view(3, 1, 1), persistent=False)

    def forward(self, images: Float[Tensor, "B N 3 H W"]) -> Float[Tensor, "BN 3 H W"]:
        """Return images of all cameras as one batch."""
        return ((images - self.mean) / self.std).flatten(0, 1).contiguous(memory_format=self.memory_format)


def survives_channels_last(network: nn.Module) -> bool:
    """Return whether the gradients of a network are safe with channels last in memory.

    For 1x1 convolutions with a stride and fewer than 16 input channels oneDNN writes past its buffer, which ends the
    process without a message (https://github.com/uxlfoundation/oneDNN/issues/6035, seen with torch 2.13 and AVX-512).
    """
    return not any(
        isinstance(layer, nn.Conv2d)
        and layer.kernel_size == (1, 1)
        and layer.stride != (1, 1)
        and layer.in_channels < ONEDNN_BLOCK
        for layer in network.modules()
    )


def on_padded(
    network: Callable[[Float[Tensor, "B 3 _ _"]], Sequence[Float[Tensor, "B _ _ _"]]],
    images: Float[Tensor, "B 3 H W"],
    strides: Sequence[int],
) -> list[Float[Tensor, "B _ _ _"]]:
    """Return maps of a network that needs sizes of images which the coarsest stride divides.

    Images are padded by zeros at the right and at the bottom, maps are cropped to ceil(size / stride).

    Args:
        network: computes the maps.
        images: of any size.
        strides: of the maps, px, finest first.
    """
    height, width = images.shape[-2:]
    padded = F.pad(images, (0, -width % strides[-1], 0, -height % strides[-1]))
    return [
        level[..., : -(-height // stride), : -(-width // stride)]
        for level, stride in zip(network(padded), strides, strict=True)
    ]


def load_or_random(weights: str | None, load: Callable[[str, bool], Network], random: Callable[[], Network]) -> Network:
    """Return the network with the named weights; if the hub does not have them, warn once and use random ones.

    Args:
        weights: name on the hub or a folder; None for random weights without network access.
        load: builds it from this name, and whether to use local files only.
        random: builds it with random weights.

    Raises:
        UserError: when they are a file or folder that cannot be loaded.
    """
    if weights is None:
        return random()
    try:
        return load(weights, not _hub_reachable(weights))
    except OSError as error:
        reason = first_line(error)
        if _is_path(weights):
            remedy = "give a folder that `save_pretrained` of transformers has written, or a name on the hub"
            raise UserError(f"weights={weights} cannot be loaded; {remedy} ({reason})") from error
        log.warning("no pretrained weights '%s', training from random ones: %s", weights, reason)
        return random()


def require_equal(found: "PretrainedConfig", expected: "PretrainedConfig", names: Iterable[str], weights: str) -> None:
    """Compare entries of two configurations; raise ValueError if the weights belong to a network of other sizes."""
    for name in names:
        ours, theirs = getattr(expected, name), getattr(found, name)
        if ours != theirs:
            raise ValueError(f"weights '{weights}' have {name} {theirs}, the config asks for {ours}; make them agree")


def _is_path(weights: str) -> bool:
    """Return whether a name is that of a file or folder, not of a repository `owner/name` of the hub."""
    return os.path.exists(weights) or weights.startswith(("/", ".", "~")) or weights.endswith(FILES)


def _hub_reachable(weights: str) -> bool:
    """Return whether the hub can be reached, since transformers would retry for minutes without a network."""
    if os.path.isdir(weights) or os.environ.get("HF_HUB_OFFLINE", "0").upper() in ("1", "TRUE", "YES", "ON"):
        return False
    endpoint = os.environ.get("HF_ENDPOINT", "https://huggingface.co")
    try:
        with urllib.request.urlopen(urllib.request.Request(endpoint, method="HEAD"), timeout=PROBE_TIMEOUT_S):
            return True
    except urllib.error.HTTPError:
        return True
    except OSError:
        return False


def check_finest_first(levels: list[int]) -> None:
    """Raise ValueError unless the strides of maps increase, as those of the maps that `FPN` returns."""
    if sorted(set(levels)) != levels:
        raise ValueError(f"levels are {levels}; give each stride once, finest first: {sorted(set(levels))}")


class FPN(nn.Module):
    """Map features of several strides to the same channels and add coarser maps to finer ones (Lin et al., 2017).

    Args:
        in_channels: of the input maps, finest first.
        channels: of the output maps.
        keep: indices of the output maps.
    """

    def __init__(self, in_channels: list[int], channels: int, keep: list[int]):
        super().__init__()
        self.keep = keep
        self.lateral = nn.ModuleList(nn.Conv2d(count, channels, 1) for count in in_channels[min(keep) :])
        self.smooth = nn.ModuleDict({str(level): nn.Conv2d(channels, channels, 3, padding=1) for level in keep})

    def forward(self, maps: list[Float[Tensor, "B _ _ _"]]) -> list[Float[Tensor, "B C _ _"]]:
        """Return the kept maps, finest first, from all maps, finest first."""
        first = min(self.keep)
        sums = [lateral(level) for lateral, level in zip(self.lateral, maps[first:], strict=True)]
        for finer in range(len(sums) - 2, -1, -1):
            size = sums[finer].shape[-2:]
            sums[finer] = sums[finer] + F.interpolate(sums[finer + 1], size=size, mode="bilinear", align_corners=False)
        return [self.smooth[str(level)](sums[level - first]) for level in sorted(self.keep)]
