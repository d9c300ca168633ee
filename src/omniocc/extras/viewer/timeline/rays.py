"""Which rays of RayIoU a prediction gets right, and where the others end."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float64, UInt8
from torch import Tensor

from omniocc.classes import FREE, UNKNOWN, ClassTable
from omniocc.geometry import Cuboid, Cylinder
from omniocc.metric import ray_hits

WITHIN_M = 2.0
"""Difference of range below which a ray of the right class counts as a hit: the middle threshold of RayIoU."""


class RayOutcomes(NamedTuple):
    """The rays that RayIoU counts, from the ego origin, by whether the prediction has their first hit.

    Attributes:
        hits_m: (H, 3) true ends of the rays with the right class within `WITHIN_M`, m, ego frame.
        misses_m: (M, 2, 3) true and predicted ends of the others; where nothing is hit, a ray ends with the grid.
    """

    hits_m: np.ndarray
    misses_m: np.ndarray


def ray_outcomes(
    truth: UInt8[Tensor, "X Y Z"],
    prediction: UInt8[Tensor, "X Y Z"],
    grid: Cylinder | Cuboid,
    classes: ClassTable,
    directions: Float64[Tensor, "R 3"],
) -> RayOutcomes:
    """Return the outcome of every ray whose true first hit is of a known class; see `omniocc.metric.RayIoU`."""
    true, found = (
        ray_hits(labels, grid, directions=directions, num_classes=classes.num_classes) for labels in (truth, prediction)
    )
    true_m, found_m = true.exit_m.double(), found.exit_m.double()
    counted = (true.labels != FREE) & (true.labels != UNKNOWN) & true_m.isfinite()
    hit = (true.labels == found.labels) & ((true_m - found_m).abs() < WITHIN_M)
    true_ends, found_ends = ((range_m[:, None] * directions).numpy() for range_m in (true_m, found_m))
    hits, misses = (counted & hit).numpy(), (counted & ~hit).numpy()
    return RayOutcomes(true_ends[hits], np.stack([true_ends, found_ends], 1)[misses])
