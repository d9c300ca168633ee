"""The frustum proportion loss of MonoScene (Cao and de Charette, 2022), around a panoramic viewpoint."""

import math

import torch
from jaxtyping import Float, Float32, Int64, UInt8
from torch import Tensor, nn
from torch.nn import functional as F

from omniocc.bounds import Size
from omniocc.classes import UNKNOWN
from omniocc.geometry import Grid

TOP_DEG = 45.0
"""Upper end of the highest frustums, which also hold all above; the lowest ones begin at its negative."""


def frustum_of_cells(grid: Grid, azimuths: int, elevations: int) -> Int64[Tensor, " cells"]:
    """Return the frustum of each cell's middle: equal steps of azimuth, and of elevation between -45 and 45 degrees."""
    x, y, z = grid.centers(torch.float64).reshape(-1, 3).unbind(-1)
    column = ((torch.atan2(y, x) / (2 * math.pi) + 0.5) * azimuths).long().clamp(0, azimuths - 1)
    elevation_deg = torch.rad2deg(torch.atan2(z, torch.hypot(x, y)))
    row = ((elevation_deg / TOP_DEG + 1) / 2 * elevations).floor().long().clamp(0, elevations - 1)
    return row * azimuths + column


class Frustums(nn.Module):
    """Divergence of the true fractions of classes from the predicted ones, in each frustum seen from the ego origin.

    A frustum is all that a patch of the panorama can show, so its fractions are known to a camera even where the range
    is not. Mean over frustums with known cells, and samples. MonoScene's frustums are those of one camera's image;
    those of a panorama's patches are the same for any rig.

    Args:
        azimuths: frustums around the car.
        elevations: frustums above one another.

    Raises:
        ValueError: if one of the numbers is not positive.
    """

    frustum: Tensor

    def __init__(self, geometry: Grid, azimuths: Size, elevations: Size):
        super().__init__()
        if azimuths < 1 or elevations < 1:
            raise ValueError(f"azimuths is {azimuths}, elevations {elevations}; both must be positive")
        self.count = azimuths * elevations
        self.register_buffer("frustum", frustum_of_cells(geometry, azimuths, elevations), persistent=False)

    def forward(self, logits: Float[Tensor, "B C *grid"], target: UInt8[Tensor, "B *grid"]) -> Float32[Tensor, ""]:
        """Return a scalar, computed in float32 also under autocast; 0 if no voxel is known."""
        with torch.autocast(logits.device.type, enabled=False):
            labels = target.flatten(1)
            classes = torch.arange(logits.shape[1], dtype=torch.uint8, device=labels.device)
            true = (labels[:, None] == classes[:, None]).float()  # UNKNOWN equals no class
            probability = F.softmax(logits.float().flatten(2), dim=1) * (labels != UNKNOWN)[:, None]
            predicted, counted = (self._sums(part) for part in (probability, true))
            size = counted.sum(1, keepdim=True).clamp(min=1)
            fractions, guesses = counted / size, predicted / size
            # a fraction of 0 counts for nothing, but 0 * log(0) would be nan
            tiny = torch.finfo(torch.float32).tiny
            divergence = (fractions * (fractions.clamp(min=tiny).log() - guesses.clamp(min=tiny).log())).sum(1)
            filled = counted.sum(1) > 0.5  # counts are whole numbers as floats
            return (divergence * filled).sum() / filled.sum().clamp(min=1)

    def _sums(self, cells: Float32[Tensor, "B C cells"]) -> Float32[Tensor, "B C frustums"]:
        return cells.new_zeros(*cells.shape[:2], self.count).index_add(2, self.frustum, cells)
