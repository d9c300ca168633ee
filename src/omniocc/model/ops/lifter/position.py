"""Features of the position of a voxel for an MLP."""

import torch
from jaxtyping import Float
from torch import Tensor

from omniocc.geometry import Grid

OCTAVES = 4


def position_features(geometry: Grid) -> Float[Tensor, "cells D"]:
    """Return features of the metric coordinates of every cell's centre, row-major, for grids of any kind.

    They are x, y, z and radius scaled to [-1, 1] (or [0, 1]), and sine and cosine of multiples of the azimuth, radius
    and height; all are continuous where the azimuth is not.
    """
    centers_m = geometry.centers(torch.float64).reshape(-1, 3)
    x, y, z = centers_m.unbind(-1)
    radius = torch.hypot(x, y)
    azimuth = torch.atan2(y, x)
    radius_unit = radius / radius.max()
    low, high = z.min(), z.max()
    height_unit = (2 * z - low - high) / (high - low).clamp(min=1e-9)
    waves = [azimuth * k for k in range(1, OCTAVES + 1)]
    waves += [torch.pi * 2**k * unit for k in range(OCTAVES) for unit in (radius_unit, height_unit)]
    columns = [x / radius.max(), y / radius.max(), height_unit, radius_unit]
    columns += [wave for angle in waves for wave in (angle.sin(), angle.cos())]
    return torch.stack(columns, dim=-1).float()
