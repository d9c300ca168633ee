"""The recipe of a stage before occupancy: steps, batches and optimiser."""

from dataclasses import dataclass

from omniocc.task.adamw import AdamW


@dataclass(frozen=True)
class Recipe:
    """Describe the training of one stage.

    Attributes:
        max_steps: optimiser steps.
        batch_size: samples per step.
        validate_every_n_epochs: epochs between validations.
        seed: of weights and order of samples.
    """

    max_steps: int
    batch_size: int
    validate_every_n_epochs: int
    seed: int
    optimizer: AdamW
