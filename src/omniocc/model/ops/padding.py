"""3D layers for grids with periodic axes, whose two ends are neighbours."""

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional as F

from omniocc.geometry import Grid
from omniocc.model.ops.norm import group_norm

Axes = tuple[int, int, int]
Periodic = tuple[bool, bool, bool]


def pad3d(volume: Float[Tensor, "B C X Y Z"], padding: Axes, periodic: Periodic) -> Float[Tensor, "B C _ _ _"]:
    """Add `padding` cells at both ends of each axis: copies from the other end where periodic, zeros elsewhere.

    Raises:
        ValueError: if a periodic axis has fewer cells than are to be copied.
    """
    for axis, (cells, wraps) in enumerate(zip(padding, periodic, strict=True), start=2):
        if not (wraps and cells):
            continue
        size = volume.shape[axis]
        if cells > size:
            raise ValueError(f"cannot wrap {cells} cells around an axis of {size}; use fewer levels or smaller kernels")
        volume = wrapped(volume, cells, axis)
    zeros = [0 if wraps else cells for cells, wraps in zip(padding, periodic, strict=True)]
    if not any(zeros):
        return volume
    return F.pad(volume, [cells for cells in reversed(zeros) for _ in range(2)])


def wrapped(values: Float[Tensor, "..."], cells: int, axis: int) -> Float[Tensor, "..."]:
    """Add copies of the cells at the other end at both ends of an axis."""
    ends = values.narrow(axis, values.shape[axis] - cells, cells), values.narrow(axis, 0, cells)
    return torch.cat([ends[0], values, ends[1]], dim=axis)


class Conv3d(nn.Conv3d):
    """Convolve a volume, keeping its size (odd kernels, stride 1) and wrapping around on periodic axes."""

    def __init__(self, in_channels: int, out_channels: int, kernel: int | Axes, periodic: Periodic, bias: bool = True):
        super().__init__(in_channels, out_channels, kernel, bias=bias)
        self.periodic = periodic
        sides = list(zip(self.kernel_size, periodic, strict=True))
        self.wrap: Axes = tuple(size // 2 if wraps else 0 for size, wraps in sides)  # type: ignore[assignment]
        self.zeros: Axes = tuple(0 if wraps else size // 2 for size, wraps in sides)  # type: ignore[assignment]

    def forward(self, volume: Float[Tensor, "B C X Y Z"]) -> Float[Tensor, "B D X Y Z"]:
        """Return the convolved volume; zeros are added by the convolution, without a copy."""
        wrapped = pad3d(volume, self.wrap, self.periodic)
        return F.conv3d(wrapped, self.weight, self.bias, padding=self.zeros)


class Residual(nn.Module):
    """Compute x + relu(norm(conv(x))) of maps or volumes, with a convolution that keeps their size and channels."""

    def __init__(self, conv: nn.Conv2d | nn.Conv3d):
        super().__init__()
        self.conv = conv
        self.norm = group_norm(conv.out_channels)

    def forward(self, values: Float[Tensor, "B C *size"]) -> Float[Tensor, "B C *size"]:
        """Return values of the same size."""
        return values + F.relu(self.norm(self.conv(values)))


def residual3d(channels: int, periodic: Periodic) -> Residual:
    """Return a residual block of a 3x3x3 convolution."""
    return Residual(Conv3d(channels, channels, 3, periodic, bias=False))


class ResidualPair(nn.Module):
    """Compute relu(x + norm(second(relu(norm(first(x)))))), with convolutions that keep size and channels."""

    def __init__(self, first: nn.Conv2d | nn.Conv3d, second: nn.Conv2d | nn.Conv3d):
        super().__init__()
        self.first = first
        self.first_norm = group_norm(first.out_channels)
        self.second = second
        self.second_norm = group_norm(second.out_channels)

    def forward(self, values: Float[Tensor, "B C *size"]) -> Float[Tensor, "B C *size"]:
        """Return values of the same size."""
        change = self.second_norm(self.second(F.relu(self.first_norm(self.first(values)))))
        return F.relu(values + change)


class Pointwise(nn.Linear):
    """Apply the same linear map in every cell: a 1x1x1 convolution, but as one matrix product."""

    def forward(self, volume: Float[Tensor, "B C X Y Z"]) -> Float[Tensor, "B D X Y Z"]:
        """Return the volume with mapped channels."""
        return super().forward(volume.movedim(1, -1)).movedim(-1, 1)


class Downsample(nn.Conv3d):
    """Halve every axis by a 2x2x2 convolution, so that a coarse cell covers exactly two fine ones.

    Rolling the volume by two cells along a periodic axis rolls the output by one. Other axes may be odd: a zero cell is
    added at their upper end.
    """

    def __init__(self, in_channels: int, out_channels: int, periodic: Periodic):
        super().__init__(in_channels, out_channels, kernel_size=2, stride=2)
        self.periodic = periodic

    def forward(self, volume: Float[Tensor, "B C X Y Z"]) -> Float[Tensor, "B D _ _ _"]:
        """Return the halved volume, sizes rounded up; raise ValueError if a periodic axis is odd."""
        odd = [size % 2 for size in volume.shape[2:]]
        for size, wraps in zip(volume.shape[2:], self.periodic, strict=True):
            if wraps and size % 2:
                raise ValueError(f"a periodic axis of {size} cells cannot be halved; use fewer levels")
        if any(odd):
            volume = F.pad(volume, [cells for size in reversed(odd) for cells in (0, size)])
        return super().forward(volume)


def check_halvings(geometry: Grid, levels: int) -> None:
    """Check that periodic axes can be halved from level to level.

    Raises:
        ValueError: naming the axis's cells and the multiple they need.
    """
    factor = 2 ** (levels - 1)
    for cells, wraps in zip(geometry.shape, geometry.periodic, strict=True):
        if wraps and cells % factor:
            need = f"{levels} levels need a periodic axis in multiples of {factor} cells, not {cells}"
            raise ValueError(f"{need}; change the grid or give fewer channels")


def upsample(volume: Float[Tensor, "B C X Y Z"], shape: Axes, periodic: Periodic) -> Float[Tensor, "B C _ _ _"]:
    """Double every axis by trilinear interpolation between cell centres, then crop to `shape`.

    Interpolates across the seam of periodic axes and holds the border's value elsewhere.
    """
    wrap: Axes = tuple(int(wraps) for wraps in periodic)  # type: ignore[assignment]
    fine = F.interpolate(pad3d(volume, wrap, periodic), scale_factor=2, mode="trilinear", align_corners=False)
    for axis, (size, wraps) in enumerate(zip(shape, periodic, strict=True), start=2):
        if fine.shape[axis] > size:
            fine = fine.narrow(axis, 2 if wraps else 0, size)
    return fine


def upsample_view(
    maps: Float[Tensor, "B C _ _"], size: tuple[int, int], periodic: tuple[bool, bool]
) -> Float[Tensor, "B C H W"]:
    """Double both axes by bilinear interpolation, across the seam of periodic ones, then crop to `size`."""
    rows, columns = map(int, periodic)
    for axis, cells in ((-2, rows), (-1, columns)):
        if cells:
            maps = wrapped(maps, cells, axis)
    fine = F.interpolate(maps, scale_factor=2, mode="bilinear", align_corners=False)
    return fine[..., 2 * rows : 2 * rows + size[0], 2 * columns : 2 * columns + size[1]]
