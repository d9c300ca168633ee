"""No refiner."""

from jaxtyping import Float
from torch import Tensor, nn


class NoRefiner(nn.Module):
    """Hands the lifted features on.

    Args:
        channels: of the volume that comes in and goes out.
    """

    def __init__(self, channels: int):
        super().__init__()
        self.channels = channels

    def forward(self, volume: Float[Tensor, "B C X Y Z"]) -> Float[Tensor, "B C X Y Z"]:
        """The same volume."""
        return volume
