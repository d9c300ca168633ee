"""No refiner."""

from jaxtyping import Float
from torch import Tensor, nn

from omniocc.model.protocols import Sketched


class NoRefiner(nn.Module):
    """Pass the lifted features on.

    Args:
        channels: of the volume that comes in and goes out.
    """

    def __init__(self, channels: int):
        super().__init__()
        self.channels = channels

    def forward(self, volume: Float[Tensor, "B C X Y Z"], sketched: Sketched) -> Float[Tensor, "B C X Y Z"]:
        """Return the same volume."""
        return volume
