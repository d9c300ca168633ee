"""AdamW with a linear warm-up and a cosine decay by steps."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import torch
from lightning.pytorch.utilities.types import OptimizerLRSchedulerConfig
from torch import nn

from omniocc.bounds import Fraction, NumberOrNone, Rate, Weight


def warmup_cosine(step: int, warmup_steps: int, total_steps: int, min_lr_ratio: float) -> float:
    """Return the learning rate at `step` as a fraction of its peak."""
    if step < warmup_steps:
        return (step + 1) / (warmup_steps + 1)
    progress = min(1.0, (step - warmup_steps) / max(1, total_steps - warmup_steps))
    return min_lr_ratio + (1 - min_lr_ratio) * 0.5 * (1 + math.cos(math.pi * progress))


def factor_of(name: str, factors: Mapping[str, float]) -> float:
    """Return the factor of the longest part that a parameter's name begins with; 1 if there is none."""
    parts = [part for part in factors if f"{name}.".startswith(f"{part}.")]
    return factors[max(parts, key=len)] if parts else 1.0


@dataclass(frozen=True)
class AdamW:
    """Describe optimiser and schedule for a Lightning module's `configure_optimizers`.

    Attributes:
        learning_rate: at the end of the warm-up.
        warmup_steps: steps of linear growth.
        weight_decay: on tensors of two dimensions and more, not on norms and biases.
        min_lr_ratio: learning rate as a fraction of `learning_rate` towards which the last steps fall.
    """

    learning_rate: Rate
    warmup_steps: NumberOrNone
    weight_decay: Weight
    min_lr_ratio: Fraction

    def configure(
        self, model: nn.Module, total_steps: int, factors: Mapping[str, float] | None = None
    ) -> OptimizerLRSchedulerConfig:
        """Return optimiser and schedule by steps for the parameters of `model` that require gradients.

        Args:
            model: has the parameters.
            total_steps: at which the schedule ends.
            factors: of the learning rate, by parts of the model (`backbone`, `refiner.down`); the longest name counts.
        """
        by_factor: dict[float, list[nn.Parameter]] = {1.0: []}
        for name, parameter in model.named_parameters():
            if parameter.requires_grad:
                by_factor.setdefault(factor_of(name, factors or {}), []).append(parameter)
        groups = []
        for factor, parameters in by_factor.items():
            rate = {} if factor == 1.0 else {"lr": factor * self.learning_rate}
            groups += [
                {"params": [p for p in parameters if p.ndim >= 2], "weight_decay": self.weight_decay, **rate},
                {"params": [p for p in parameters if p.ndim < 2], "weight_decay": 0.0, **rate},
            ]
        optimizer = self.optimizer(groups)
        schedule = torch.optim.lr_scheduler.LambdaLR(
            optimizer, lambda step: warmup_cosine(step, self.warmup_steps, total_steps, self.min_lr_ratio)
        )
        return {"optimizer": optimizer, "lr_scheduler": {"scheduler": schedule, "interval": "step"}}

    def optimizer(self, groups: list[dict[str, Any]]) -> torch.optim.Optimizer:
        """Return the optimiser of parameters in groups."""
        return torch.optim.AdamW(groups, lr=self.learning_rate)
