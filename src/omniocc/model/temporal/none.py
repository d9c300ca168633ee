"""No temporal fusion."""

from jaxtyping import Bool, Float
from torch import Tensor, nn

from omniocc.model.protocols import Volumes


class NoTemporal(nn.Module):
    """Use the newest frame only."""

    frames = 1
    history_gradient = False

    def __init__(self):  # nn.Module's own would accept any argument
        super().__init__()

    def forward(
        self, volumes: Volumes, world_from_ego: Float[Tensor, "B T 4 4"], exists: Bool[Tensor, "B T"]
    ) -> Float[Tensor, "B C X Y Z"]:
        """Return the newest volume, unchanged."""
        return volumes[-1]
