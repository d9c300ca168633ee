"""No semantic head."""

from jaxtyping import Float
from torch import Tensor, nn


class NoSemanticHead(nn.Module):
    """Leaves the pixels alone."""

    def __init__(self):  # of its own: nn.Module's would accept anything
        super().__init__()

    def forward(self, features: list[Float[Tensor, "B N C _ _"]]) -> None:
        """Nothing."""
        return
