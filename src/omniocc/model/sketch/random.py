"""A fixed random share of the voxels."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

from omniocc.camera import Rig
from omniocc.geometry import Grid


def random_cells(cells: int, ratio: float, seed: int) -> Bool[Tensor, " cells"]:
    """Marks round(ratio * cells) cells; the same ones for the same seed in every process."""
    order = torch.randperm(cells, generator=torch.Generator().manual_seed(seed))
    marked = torch.zeros(cells, dtype=torch.bool)
    marked[order[: round(ratio * cells)]] = True
    return marked


class Random(nn.Module):
    """One random set of cells for all frames: what a sketch is worth that looks at nothing.

    Args:
        geometry: the voxel grid.
        ratio: share of the cells, above 0 and at most 1.
        seed: of the choice.

    Raises:
        ValueError: if the ratio is out of range.
    """

    candidates: Tensor

    def __init__(self, geometry: Grid, ratio: float = 0.25, seed: int = 0):
        super().__init__()
        if not 0 < ratio <= 1:
            raise ValueError(f"ratio is {ratio}; it must be above 0 and at most 1")
        marked = random_cells(geometry.num_cells, ratio, seed)
        self.register_buffer("candidates", marked.reshape(geometry.shape))

    def forward(self, images: Float[Tensor, "B N 3 H W"], rigs: tuple[Rig, ...]) -> Bool[Tensor, "B X Y Z"]:
        """The same cells for every sample."""
        return self.candidates.expand(len(images), *self.candidates.shape)
