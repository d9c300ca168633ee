"""Random numbers of one training step, which are the same in a resumed run."""

import numpy as np
import torch
from lightning.pytorch import LightningModule


def step_generator(task: LightningModule, seed: int, batch_index: int) -> torch.Generator:
    """Return a CPU generator that depends only on seed, optimiser step, batch index in the epoch, and process."""
    key = [seed, task.global_step, batch_index, task.global_rank]
    return torch.Generator().manual_seed(int(np.random.SeedSequence(key).generate_state(1)[0]))
