"""The norm of all convolutional networks, and the check of their halved grids."""

from torch import nn

from omniocc.geometry import Grid

GROUP_CHANNELS = 8


def group_norm(channels: int) -> nn.GroupNorm:
    """Return a norm of single samples, so that results do not depend on the batch.

    Raises:
        ValueError: if the channels do not split into groups of 8.
    """
    if channels % GROUP_CHANNELS:
        raise ValueError(f"{channels} channels; every level needs a multiple of {GROUP_CHANNELS}")
    return nn.GroupNorm(channels // GROUP_CHANNELS, channels)


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
