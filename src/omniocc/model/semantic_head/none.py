"""No semantic head."""

from jaxtyping import Float
from torch import Tensor, nn


class NoSemanticHead(nn.Module):
    """Leaves the pixels alone."""

    def forward(self, features: list[Float[Tensor, "B N C _ _"]]) -> None:
        """Nothing."""
        return
