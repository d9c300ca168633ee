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
                self._step_matrices(group)
        super().step()
        return loss

    def _step_matrices(self, group: dict[str, Any]) -> None:
        """Step all matrices of a group together, and drop their gradients."""
        grads = {p: p.grad for p in group["params"] if p.grad is not None}
        if not grads:
            return
        parameters, rate = list(grads), group["lr"]
        means = [self._momentum(p) for p in parameters]
        torch._foreach_lerp_(means, list(grads.values()), 1 - group["momentum"])
        ahead = torch._foreach_lerp(list(grads.values()), means, group["momentum"])
        updates = orthogonal([matrix.flatten(1) for matrix in ahead])
        torch._foreach_mul_(updates, [RMS * max(update.shape) ** 0.5 for update in updates])
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


def orthogonal(matrices: list[Float[Tensor, "_ _"]]) -> list[Float[Tensor, "_ _"]]:
    """Return matrices with the same singular vectors and singular values of about 1 (0.7 to 1.2).

    The iteration `X <- p(X X^T) X` only multiplies from the left, by polynomials of X X^T. These are computed from the
    small squares alone, for all matrices of one number of rows together, and applied once.
    """
    wide = [matrix.float() if len(matrix) <= matrix.shape[1] else matrix.float().T for matrix in matrices]
    found = list(wide)
    for places in grouped(map(len, wide)).values():
        factors = polynomials(torch.stack([wide[place] @ wide[place].T for place in places]))
        for place, factor in zip(places, factors.unbind(), strict=True):
            found[place] = factor @ wide[place]
    return [update if len(matrix) == len(update) else update.T for matrix, update in zip(matrices, found, strict=True)]


def polynomials(squares: Float[Tensor, "K M M"]) -> Float[Tensor, "K M M"]:
    """Return the matrices by which the Newton-Schulz iteration multiplies each X in all, from X X^T."""
    # divided by the norm of X no singular value is above 1, where the iteration converges
    norm = squares.diagonal(dim1=1, dim2=2).sum(1).sqrt().clamp(min=1e-7)[:, None, None]
    square = squares / norm**2
    product = torch.eye(squares.shape[1], device=squares.device) / norm
    first, third, fifth = COEFFICIENTS
    for _ in range(ITERATIONS):
        factor = torch.baddbmm(square, square, square, beta=third, alpha=fifth)
        factor.diagonal(dim1=1, dim2=2).add_(first)
        product, square = torch.bmm(factor, product), torch.bmm(torch.bmm(factor, square), factor)
    return product
