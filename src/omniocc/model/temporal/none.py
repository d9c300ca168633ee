"""No temporal fusion."""

from jaxtyping import Bool, Float
from torch import Tensor, nn


class NoTemporal(nn.Module):
    """Use the newest frame only."""

    frames = 1
    history_gradient = False

    def __init__(self):  # of its own: nn.Module's would accept anything
        super().__init__()

    def forward(
        self,
        volumes: list[Float[Tensor, "B C X Y Z"]],
        world_from_ego: Float[Tensor, "B T 4 4"],
        exists: Bool[Tensor, "B T"],
    ) -> Float[Tensor, "B C X Y Z"]:
        """Return the newest volume, unchanged."""
        return volumes[-1]
