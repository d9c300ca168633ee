"""Random numbers of one training step, so that a resumed run draws what an undisturbed one would have drawn."""

import numpy as np
import torch
from lightning.pytorch import LightningModule


def step_generator(task: LightningModule, seed: int, batch_index: int) -> torch.Generator:
    """Return a CPU generator that is a function of seed, optimiser step, batch and process alone."""
    key = [seed, task.global_step, batch_index, task.global_rank]
    return torch.Generator().manual_seed(int(np.random.SeedSequence(key).generate_state(1)[0]))
