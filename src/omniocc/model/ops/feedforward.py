"""The layer of transformers, and its second half."""

from typing import Any

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


class AttentionLayer(nn.Module):
    """Apply an attention, whose result is added to the queries and normalised, and a feed-forward part."""

    def __init__(self, attention: nn.Module, channels: int, feedforward_channels: int):
        super().__init__()
        self.attention = attention
        self.attention_norm = nn.LayerNorm(channels)
        self.feedforward = FeedForward(channels, feedforward_channels)

    def forward(self, queries: Float[Tensor, "*batch C"], *arguments: Any) -> Float[Tensor, "*_ C"]:
        """Return the queries after attention, which gets them and the further arguments."""
        return self.feedforward(self.attention_norm(queries + self.attention(queries, *arguments)))
