"""The second half of a transformer layer."""

from jaxtyping import Float
from torch import Tensor, nn


class FeedForward(nn.Module):
    """Add the output of a perceptron with one hidden layer to each query, then normalise."""

    def __init__(self, channels: int, hidden_channels: int):
        super().__init__()
        first, second = nn.Linear(channels, hidden_channels), nn.Linear(hidden_channels, channels)
        self.layers = nn.Sequential(first, nn.ReLU(), second)
        self.norm = nn.LayerNorm(channels)

    def forward(self, queries: Float[Tensor, "*batch C"]) -> Float[Tensor, "*batch C"]:
        """Return queries of the same shape."""
        return self.norm(queries + self.layers(queries))
