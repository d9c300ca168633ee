"""3D encoder-decoder with skips (paper, section IV-F)."""

from jaxtyping import Float
from torch import Tensor

from omniocc.bounds import Size
from omniocc.geometry import Grid
from omniocc.model.ops.padding import residual3d
from omniocc.model.ops.pyramid import Pyramid
from omniocc.model.protocols import Sketched


class UNet(Pyramid):
    """Apply residual blocks on a pyramid of halved grids with added skips; wraps around on the grid's periodic axes.

    The finest level, the most expensive one, has a block only on the way up. Rolling the input
    along a periodic axis by a multiple of 2**(levels-1) cells rolls the output.

    Args:
        in_channels: of the input volume.
        channels: of each level, finest first; multiples of 8. The finest is that of the output.

    Raises:
        ValueError: if a periodic axis cannot be halved often enough, or the channels do not split into groups.
    """

    def __init__(self, geometry: Grid, in_channels: Size, channels: list[Size]):
        super().__init__(geometry, in_channels, channels, residual3d)

    def forward(self, volume: Float[Tensor, "B C X Y Z"], sketched: Sketched) -> Float[Tensor, "B D X Y Z"]:
        """Refine a volume; the result has `channels` channels."""
        return self.levels(volume)[-1]
