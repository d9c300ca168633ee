"""Muon: steps whose matrices have equal singular values, which learn more in the same number of steps."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from omniocc.bounds import Kept
from omniocc.train.adamw import AdamW

COEFFICIENTS = (3.4445, -4.7750, 2.0315)
"""Of the quintic Newton-Schulz iteration (Jordan, 2024, https://kellerjordan.github.io/posts/muon)."""
ITERATIONS = 5
LEAST_SIDE = 8
"""Rows and columns that a weight needs to count as a matrix."""
RMS = 0.2
"""Root mean square of a step's entries at learning rate 1, about that of AdamW (Liu et al., 2025, arXiv 2502.16982)."""


@dataclass(frozen=True)
class Muon(AdamW):
    """Describe Muon for matrices and kernels (Jordan, 2024), AdamW for all other parameters, and the schedule.

    Attributes:
        momentum: fraction of the running mean of gradients that is kept in each step.
    """

    momentum: Kept = 0.95

    def optimizer(self, groups: list[dict[str, Any]]) -> torch.optim.Optimizer:
        """Return the optimiser of parameters in groups."""
        split = []
        for group in groups:
            matrices = [p for p in group["params"] if is_matrix(p)]
            others = [p for p in group["params"] if not is_matrix(p)]
            split += [{**group, "params": matrices, "momentum": self.momentum}, {**group, "params": others}]
        return MuonOptimizer([group for group in split if group["params"]], lr=self.learning_rate)


class MuonOptimizer(torch.optim.AdamW):
    """Step by Muon in the groups that have a `momentum`, by AdamW in the others."""

    @torch.no_grad()
    def step(self, closure: Callable[[], Any] | None = None) -> Any:  # type: ignore[override]
        """Make a step, and return the loss that `closure` returns; gradients of Muon's parameters are used up."""
        loss = None
        if closure is not None:
            with torch.enable_grad():
                loss = closure()
        for group in self.param_groups:
            for parameter in group["params"] if "momentum" in group else ():
                if parameter.grad is not None:
                    self._step_matrix(parameter, parameter.grad, group)
                    parameter.grad = None
        super().step()
        return loss

    def _step_matrix(self, parameter: Tensor, grad: Tensor, group: dict[str, Any]) -> None:
        state = self.state[parameter]
        if not state:
            # AdamW loads no state without `step`
            state["momentum"], state["step"] = torch.zeros_like(parameter), torch.zeros(())
        mean = state["momentum"].lerp_(grad, 1 - group["momentum"])
        ahead = grad.lerp(mean, group["momentum"]).flatten(1)
        update = orthogonal(ahead) * (RMS * max(ahead.shape) ** 0.5)
        parameter.mul_(1 - group["lr"] * group["weight_decay"])
        parameter.add_(update.view_as(parameter), alpha=-group["lr"])


def is_matrix(parameter: Tensor) -> bool:
    """Return whether a parameter, its axes after the first taken as one, is a matrix of more than a few rows."""
    return parameter.ndim >= 2 and len(parameter) >= LEAST_SIDE and parameter[0].numel() >= LEAST_SIDE


def orthogonal(matrix: Float[Tensor, "M N"]) -> Float[Tensor, "M N"]:
    """Return a matrix with the same singular vectors and singular values of about 1 (0.7 to 1.2)."""
    wide = matrix if matrix.shape[0] <= matrix.shape[1] else matrix.T  # so that `square` is the smaller product
    # divided by the norm no singular value is above 1, where the iteration converges
    wide = wide.float() / wide.norm().clamp(min=1e-7)
    first, third, fifth = COEFFICIENTS
    for _ in range(ITERATIONS):
        square = wide @ wide.T
        wide = first * wide + (third * square + fifth * square @ square) @ wide
    return wide if matrix.shape[0] <= matrix.shape[1] else wide.T
