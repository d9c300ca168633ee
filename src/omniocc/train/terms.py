"""Named loss terms: summed, logged, and checked to be finite."""

from collections.abc import Mapping

import torch
from lightning.pytorch import LightningModule
from torch import Tensor

from omniocc.batch import Batch
from omniocc.errors import UserError


def log_terms(task: LightningModule, terms: Mapping[str, Tensor], batch: Batch) -> Tensor:
    """Return the sum of the terms, after logging `train/loss/<name>` and `train/loss`.

    Raises:
        UserError: naming the frames, when there are no terms or their sum is not finite.
    """
    if not terms:
        raise UserError(f"nothing to learn from: no loss applies to the labels of {', '.join(batch.frame_ids)}")
    total = torch.stack(list(terms.values())).sum()
    size = len(batch.frame_ids)
    task.log_dict({f"train/loss/{name}": term.detach() for name, term in terms.items()}, batch_size=size)
    task.log("train/loss", total.detach(), batch_size=size)
    if not torch.isfinite(total):
        values = ", ".join(f"{name}={float(term.detach()):.3g}" for name, term in terms.items())
        raise UserError(
            f"the loss is not finite at step {task.global_step} ({values}); frames: {', '.join(batch.frame_ids)}"
        )
    return total
