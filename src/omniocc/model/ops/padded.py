"""Batches of samples with different numbers of cameras and sizes of image.

Such samples are padded by zeros at the end of the camera axis, at the right and at the bottom. A sample's rig gives its
number of images and the size of its largest camera, its *frame*. Maps of a stride have ceil(size / stride) rows and
columns. Networks run on cropped images, so that padding does not change their results.
"""

from collections.abc import Callable, Hashable, Iterable, Sequence
from typing import NamedTuple, TypeVar

import torch
from jaxtyping import Float, Shaped, UInt8
from torch import Tensor
from torch.nn import functional as F

from omniocc.camera import Rig

FeatureMaps = list[Float[Tensor, "B N C _ _"]]
"""Maps of all cameras at several strides, finest first."""

Rigs = tuple[Rig, ...]
"""One rig per sample."""

Images = UInt8[Tensor, "... N 3 H W"] | Float[Tensor, "... N 3 H W"]
"""RGB of frames or windows of frames, 0..255 as uint8 or in [0, 1] as floats."""

Key = TypeVar("Key", bound=Hashable)


def to_unit_range(images: Images) -> Float[Tensor, "..."]:
    """Return RGB in [0, 1]; floats are returned as they are."""
    return images if images.is_floating_point() else images.float() / 255


class ImageShape(NamedTuple):
    """Number of cameras, and height and width of the largest, px."""

    cameras: int
    height: int
    width: int

    def at_stride(self, stride: int) -> "ImageShape":
        """Return the shape of maps of a stride."""
        return ImageShape(self.cameras, -(-self.height // stride), -(-self.width // stride))


def image_shape(rig: Rig) -> ImageShape:
    """Return the shape of a rig's images without padding."""
    width, height = frame_size(rig)
    return ImageShape(len(rig.cameras), height, width)


def frame_size(rig: Rig) -> tuple[int, int]:
    """Return width and height of the smallest image into which each camera's image fits, px."""
    return max(camera.width for camera in rig.cameras), max(camera.height for camera in rig.cameras)


def crop(maps: Float[Tensor, "B N *C _ _"], rig: Rig, stride: int = 1) -> Float[Tensor, "B n *C _ _"]:
    """Return the part of padded images, or of maps of a stride, that belongs to a rig's cameras.

    Raises:
        ValueError: if the rig has more cameras or larger images.
    """
    shape = image_shape(rig).at_stride(stride)
    given = ImageShape(maps.shape[1], maps.shape[-2], maps.shape[-1])
    if any(needed > size for needed, size in zip(shape, given, strict=True)):
        scale = f" at stride {stride}" if stride > 1 else ""
        raise ValueError(f"the rig has {_text(shape)} but there are images of {_text(given)}{scale}; see Rig.resized")
    return maps[:, : shape.cameras, ..., : shape.height, : shape.width]


def _text(shape: ImageShape) -> str:
    return f"{shape.cameras} cameras of {shape.width}x{shape.height} px"


def shape_groups(rigs: Sequence[Rig]) -> list[list[int]]:
    """Return the samples of a batch in groups whose images have one shape without padding."""
    return list(grouped(map(image_shape, rigs)).values())


def grouped(keys: Iterable[Key]) -> dict[Key, list[int]]:
    """Return the positions of each distinct key, in the order in which the keys first appear."""
    groups: dict[Key, list[int]] = {}
    for position, key in enumerate(keys):
        groups.setdefault(key, []).append(position)
    return groups


def joined(parts: Sequence[Tensor]) -> Tensor:
    """Return parts along the first axis as one, uncopied if there is only one."""
    return parts[0] if len(parts) == 1 else torch.cat(list(parts))


def in_batch_order(parts: Sequence[Shaped[Tensor, "_ *S"]], groups: Iterable[Sequence[int]]) -> Shaped[Tensor, "B *S"]:
    """Return the results of groups of samples together, in the order of the samples in the batch."""
    if len(parts) == 1:
        return parts[0]
    order = torch.tensor([sample for group in groups for sample in group]).argsort()
    return torch.cat(list(parts))[order.to(parts[0].device)]


def by_shape(
    network: Callable[[Float[Tensor, "b n 3 _ _"], tuple[Rig, ...]], Sequence[Float[Tensor, "b n C _ _"]]],
    images: Float[Tensor, "B N 3 H W"],
    rigs: tuple[Rig, ...],
    strides: Sequence[int],
) -> list[Float[Tensor, "B N C _ _"]]:
    """Run a network on samples of equal shape together, without their padding, and pad its maps by zeros.

    The network computes maps of these strides from images and their rigs. Raises ValueError as `crop` does.
    """
    batch = ImageShape(images.shape[1], *images.shape[-2:])
    groups = shape_groups(rigs)
    parts = []
    for samples in groups:
        same = tuple(rigs[sample] for sample in samples)
        parts.append(network(crop(images if len(groups) == 1 else images[samples], same[0]), same))
    if len(groups) == 1 and image_shape(rigs[0]) == batch:
        return list(parts[0])
    levels = zip(*parts, strict=True)
    return [_joined(level, groups, batch.at_stride(stride)) for level, stride in zip(levels, strides, strict=True)]


def _joined(parts: Sequence[Tensor], groups: list[list[int]], shape: ImageShape) -> Tensor:
    """Return the maps of all groups in the order of samples, padded to `shape`."""
    maps = parts[0].new_zeros(sum(map(len, groups)), shape.cameras, parts[0].shape[2], shape.height, shape.width)
    for part, samples in zip(parts, groups, strict=True):
        padding = (0, shape.width - part.shape[-1], 0, shape.height - part.shape[-2], 0, 0)
        padding = (*padding, 0, shape.cameras - part.shape[1])
        maps = maps.index_copy(0, torch.tensor(samples, device=maps.device), F.pad(part, padding))
    return maps
