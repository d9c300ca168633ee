"""Muon: steps whose matrices have equal singular values, which learn more in the same number of steps."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from omniocc.bounds import Kept
from omniocc.model.ops.padded import grouped
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
            if "momentum" in group:
                self._step_matrices([p for p in group["params"] if p.grad is not None], group)
        super().step()
        return loss

    def _step_matrices(self, parameters: list[Tensor], group: dict[str, Any]) -> None:
        """Step all matrices of a group together, and drop their gradients."""
        if not parameters:
            return
        grads, rate = [p.grad for p in parameters], group["lr"]
        means = [self._momentum(p) for p in parameters]
        torch._foreach_lerp_(means, grads, 1 - group["momentum"])
        ahead = torch._foreach_lerp(grads, means, group["momentum"])
        updates = orthogonal_each([matrix.flatten(1) for matrix in ahead])
        torch._foreach_mul_(parameters, 1 - rate * group["weight_decay"])
        torch._foreach_add_(parameters, [u.view_as(p) for u, p in zip(updates, parameters, strict=True)], alpha=-rate)
        for parameter in parameters:
            parameter.grad = None

    def _momentum(self, parameter: Tensor) -> Tensor:
        state = self.state[parameter]
        if not state:
            # AdamW loads no state without `step`
            state["momentum"], state["step"] = torch.zeros_like(parameter), torch.zeros(())
        return state["momentum"]


def is_matrix(parameter: Tensor) -> bool:
    """Return whether a parameter, its axes after the first taken as one, is a matrix of more than a few rows."""
    return parameter.ndim >= 2 and len(parameter) >= LEAST_SIDE and parameter[0].numel() >= LEAST_SIDE


def orthogonal_each(matrices: list[Float[Tensor, "_ _"]]) -> list[Float[Tensor, "_ _"]]:
    """Return `orthogonal` of each matrix, scaled to entries of about `RMS`; those of one shape are computed together."""
    updates = list(matrices)
    for (rows, columns), places in grouped(matrix.shape for matrix in matrices).items():
        found = orthogonal(torch.stack([matrices[place] for place in places])) * (RMS * max(rows, columns) ** 0.5)
        for place, update in zip(places, found.unbind(), strict=True):
            updates[place] = update
    return updates


def orthogonal(matrices: Float[Tensor, "K M N"]) -> Float[Tensor, "K M N"]:
    """Return matrices with the same singular vectors and singular values of about 1 (0.7 to 1.2)."""
    tall = matrices.shape[1] > matrices.shape[2]
    wide = matrices.mT if tall else matrices  # so that `square` is the smaller product
    # divided by the norm no singular value is above 1, where the iteration converges
    wide = wide.float() / torch.linalg.matrix_norm(wide.float(), keepdim=True).clamp(min=1e-7)
    first, third, fifth = COEFFICIENTS
    for _ in range(ITERATIONS):
        square = wide @ wide.mT
        wide = torch.baddbmm(wide, torch.baddbmm(square, square, square, beta=third, alpha=fifth), wide, beta=first)
    return wide.mT if tall else wide
