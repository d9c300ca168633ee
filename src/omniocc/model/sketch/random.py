"""A fixed random fraction of the voxels."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

from omniocc.geometry import Grid
from omniocc.model.ops.padded import Rigs
from omniocc.model.protocols import Sketched


def random_cells(cells: int, fraction: float, seed: int) -> Bool[Tensor, " cells"]:
    """Mark round(fraction * cells) cells, the same ones for the same seed in every process."""
    order = torch.randperm(cells, generator=torch.Generator().manual_seed(seed))
    marked = torch.zeros(cells, dtype=torch.bool)
    marked[order[: round(fraction * cells)]] = True
    return marked


class Random(nn.Module):
    """Choose one random set of cells for all frames: the baseline of a sketch that ignores the images.

    Args:
        fraction: of the cells, above 0 and at most 1.
        seed: of the choice.

    Raises:
        ValueError: if the fraction is out of range.
    """

    candidates: Tensor

    def __init__(self, geometry: Grid, fraction: float = 0.25, seed: int = 0):
        super().__init__()
        if not 0 < fraction <= 1:
            raise ValueError(f"fraction is {fraction}; it must be above 0 and at most 1")
        marked = random_cells(geometry.num_cells, fraction, seed)
        self.register_buffer("candidates", marked.reshape(geometry.shape))

    def forward(
        self, images: Float[Tensor, "B N 3 H W"], rigs: Rigs, true_range_m: Float[Tensor, "B h w"] | None = None
    ) -> Sketched:
        """Return the same cells for every sample."""
        return Sketched(self.candidates.expand(len(images), *self.candidates.shape))
