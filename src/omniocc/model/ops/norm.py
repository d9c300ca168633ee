"""The norm of all convolutional networks."""

from torch import nn

GROUP_CHANNELS = 8


def group_norm(channels: int) -> nn.GroupNorm:
    """Return a norm of single samples, so that results do not depend on the batch.

    Raises:
        ValueError: if the channels do not split into groups of 8.
    """
    if channels % GROUP_CHANNELS:
        raise ValueError(f"{channels} channels; every level needs a multiple of {GROUP_CHANNELS}")
    return nn.GroupNorm(channels // GROUP_CHANNELS, channels)
