"""Better and worse ranges in training: a network that learns from one kind trusts that kind only."""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn import functional as F

from omniocc.bounds import Fraction, Weight

BLOCK_PX = 12
"""Distance of the directions for which errors are drawn; between them they are interpolated."""


@dataclass(frozen=True)
class RangeMixture:
    """Replace the predicted ranges of some samples: by the true ones, or by themselves with errors added.

    Attributes:
        true_fraction: probability that a sample gets the true ranges.
        noisy_fraction: probability that a sample's ranges get errors.
        noise: standard deviation of these errors, of the logarithm of the range.

    Raises:
        ValueError: if the two fractions are more than 1 together.
    """

    true_fraction: Fraction
    noisy_fraction: Fraction
    noise: Weight

    def __post_init__(self) -> None:
        """Check that a sample is not to be both."""
        total = self.true_fraction + self.noisy_fraction
        if total > 1:
            raise ValueError(f"true_fraction and noisy_fraction are {total:g} together; they must be at most 1")

    def __call__(
        self,
        range_m: Float[Tensor, "B h w"],
        true_range_m: Float[Tensor, "B h w"] | None,
        generator: torch.Generator,
    ) -> tuple[Float[Tensor, "B h w"], Bool[Tensor, " B"]]:
        """Return ranges, m, and which samples were changed.

        Args:
            range_m: predicted; nan where unknown.
            true_range_m: inf for the sky, nan where unknown, where the predicted range stays; None: no sample is true.
            generator: source of all random choices, on the CPU.
        """
        draw = torch.rand(len(range_m), generator=generator).to(range_m.device)
        field = smooth_field(range_m.shape, generator).to(range_m)
        true, noisy = draw < self.true_fraction, draw >= 1 - self.noisy_fraction
        if true_range_m is None:
            true = torch.zeros_like(true)
        else:
            range_m = torch.where(true[:, None, None] & ~true_range_m.isnan(), true_range_m, range_m)
        return torch.where(noisy[:, None, None], range_m * (self.noise * field).exp(), range_m), true | noisy


def smooth_field(shape: torch.Size, generator: torch.Generator) -> Float[Tensor, "B h w"]:
    """Return normal random numbers of mean 0 and about standard deviation 1, smooth over panoramas that wrap around."""
    batch, height, width = shape
    rows, columns = max(2, height // BLOCK_PX), max(2, width // BLOCK_PX)
    coarse = F.pad(torch.randn(batch, 1, rows, columns, generator=generator), (1, 1, 0, 0), mode="circular")
    fine = F.interpolate(coarse, (height, width * (columns + 2) // columns), mode="bicubic")[:, 0]
    start = (fine.shape[-1] - width) // 2
    return fine[..., start : start + width]
