"""Scale-invariant log loss of ranges (Eigen et al., 2014, eq. 4)."""

import torch
from jaxtyping import Float, Float32
from torch import Tensor, nn

EPSILON = 1e-6


class SILog(nn.Module):
    """Loss sqrt(mean(d^2) - focus * mean(d)^2) with d = log predicted - log true range, in float32.

    Pixels count whose true range is finite and above 0: those of the sky (inf) and without a measurement (nan) do not.

    Args:
        focus: fraction of the squared common error of all pixels that is removed, in [0, 1]; 0.85 is usual.

    Raises:
        ValueError: if `focus` is out of range.
    """

    def __init__(self, focus: float):
        super().__init__()
        if not 0 <= focus <= 1:
            raise ValueError(f"focus is {focus}; it must be from 0 to 1")
        self.focus = focus

    def forward(self, log_range: Float[Tensor, "..."], true_range_m: Float[Tensor, "..."]) -> Float32[Tensor, ""]:
        """Return a scalar; 0 if no pixel counts. `log_range` is the natural logarithm of metres."""
        counted = true_range_m.isfinite() & (true_range_m > 0)
        true = torch.where(counted, true_range_m.float(), 1.0).log()
        error = torch.where(counted, log_range.float() - true, 0.0)
        count = counted.sum().clamp(min=1)
        squares, mean = error.square().sum() / count, error.sum() / count
        # the root is not differentiable at 0: if all pixels are exact or none counts
        return (squares - self.focus * mean.square()).clamp(min=0).add(EPSILON).sqrt() - EPSILON**0.5
