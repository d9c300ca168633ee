"""No refiner."""

from jaxtyping import Float
from torch import Tensor, nn

from omniocc.bounds import Size
from omniocc.model.protocols import Sketched


class NoRefiner(nn.Module):
    """Return the lifted features unchanged."""

    def __init__(self, channels: Size):
        super().__init__()
        self.channels = channels

    def forward(self, volume: Float[Tensor, "B C X Y Z"], sketched: Sketched) -> Float[Tensor, "B C X Y Z"]:
        """Return the same volume."""
        return volume
