"""Calibrate the probability that a network gives its spheres to the probability that a range is right."""

from typing import Any

import torch
from jaxtyping import Bool, Float, Float64
from torch import Tensor, nn

RIGHT_WITHIN = 0.1
"""Relative error up to which a range is right."""
LEAST_PROBABILITY = 1e-4
"""Least probability, and least distance from 1, that enters the fit."""
NEWTON_STEPS = 25  # measured: 8 bring the weights of 5,000 ranges to rounding
RIDGE = 1e-6
"""Weight of the L2 penalty on the weights: without it the fit diverges where all ranges are right."""


def confidence_features(probability: Float[Tensor, "..."], range_m: Float[Tensor, "..."]) -> Float[Tensor, "... 3"]:
    """Return what the confidence depends on: log odds of the probability, log of the range, and 1."""
    log_odds = probability.float().clamp(LEAST_PROBABILITY, 1 - LEAST_PROBABILITY).logit()
    return torch.stack([log_odds, range_m.float().log(), torch.ones_like(log_odds)], -1)


def fit_logistic(features: Float[Tensor, "N F"], right: Bool[Tensor, " N"]) -> Float64[Tensor, " F"]:
    """Return the weights of the logistic regression of `right`, by Newton's method."""
    x, y = features.double(), right.double()
    weights = x.new_zeros(x.shape[1])
    ridge = RIDGE * torch.eye(x.shape[1], dtype=x.dtype, device=x.device)
    for _ in range(NEWTON_STEPS):
        p = (x @ weights).sigmoid()
        gradient = x.T @ (p - y) / len(x) + RIDGE * weights
        curvature = (x * (p * (1 - p)).unsqueeze(1)).T @ x / len(x) + ridge
        weights = weights - torch.linalg.solve(curvature, gradient)
    return weights


class Confidence(nn.Module):
    """Probability that a range is within `RIGHT_WITHIN` of the true one (Platt scaling, with the range as an input).

    Before `fit` it is the probability that the network gives.
    """

    weights: Tensor

    def __init__(self) -> None:
        super().__init__()
        self.register_buffer("weights", torch.tensor([1.0, 0.0, 0.0]))

    def forward(self, probability: Float[Tensor, "*at"], range_m: Float[Tensor, "*at"]) -> Float[Tensor, "*at"]:
        """Return the confidence in ranges (m) to which a network gives these probabilities."""
        # no matrix product, which autocast would compute in half precision
        return (confidence_features(probability, range_m) * self.weights).sum(-1).sigmoid()

    def fit(self, confidence: Float[Tensor, " N"], range_m: Float[Tensor, " N"], right: Bool[Tensor, " N"]) -> None:
        """Fit to ranges (m) of validation scenes: the present confidence in each, and whether it is right."""
        # the present log odds are linear in the features, so that a fit on top of them only changes the weights
        scale, by_range, offset = fit_logistic(confidence_features(confidence, range_m), right).to(self.weights)
        self.weights.copy_(scale * self.weights + torch.stack([0 * scale, by_range, offset]))

    def _load_from_state_dict(self, state_dict: dict[str, Any], prefix: str, *rest: Any) -> None:
        """Load weights; keep the present ones if a checkpoint has none, as before there was a calibration."""
        state_dict.setdefault(f"{prefix}weights", self.weights)
        super()._load_from_state_dict(state_dict, prefix, *rest)
