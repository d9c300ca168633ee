"""The data of a run as Lightning takes them."""

from typing import Any

import torch
from lightning.pytorch import LightningDataModule
from torch.utils.data import DataLoader

from omniocc.batch import Batch, to_device
from omniocc.data import OccupancyData


class DataModule(LightningDataModule):
    """Gives every process its part of the batches and goes on after a stop.

    A run that resumes from a checkpoint written after any batch or validation uses exactly the batches that were left.
    (For checkpoints written in `on_train_epoch_end` this holds with `max_epochs` only: with `max_steps`, Lightning 2.6
    counts such an epoch twice and skips one order.)

    Args:
        data: whose batches it gives.
    """

    __qualname__ = "OccupancyData"  # Lightning keeps the state under it in checkpoints

    def __init__(self, data: OccupancyData):
        super().__init__()
        self.data = data
        self._resume = {"epoch": 0, "batches": 0}

    def prepare_data(self) -> None:
        """Make the scenes and labels that are missing; raises as the method of the data does."""
        self.data.prepare_data()

    def setup(self, stage: str) -> None:
        """Open the splits."""
        self.data.setup()

    def train_dataloader(self) -> DataLoader[Batch]:
        """Return the shuffled loader, which leaves out the batches of its first epoch that were used before."""
        accumulated = 1 if self.trainer is None else self.trainer.accumulate_grad_batches
        return self.data.train_dataloader(*self._rank(), accumulated, **self._resume)

    def val_dataloader(self) -> DataLoader[Batch]:
        """Return the loader of validation samples in order."""
        return self.data.in_order("val", *self._rank())

    def test_dataloader(self) -> DataLoader[Batch]:
        """Return the loader of test samples in order."""
        return self.data.in_order("test", *self._rank())

    def state_dict(self) -> dict[str, Any]:
        """Return the epoch and the number of its finished batches, from which a resumed run continues."""
        if self.trainer is None:
            return dict(self._resume)
        loop = self.trainer.fit_loop
        epoch = loop.epoch_progress.state_dict()["current"]
        batch = loop.epoch_loop.batch_progress.state_dict()["current"]
        if epoch["started"] == epoch["processed"]:  # between two epochs
            return {"epoch": epoch["processed"], "batches": 0}
        if batch["processed"] >= self.trainer.num_training_batches:  # the epoch does not count as done yet
            return {"epoch": epoch["processed"] + 1, "batches": 0}
        return {"epoch": epoch["processed"], "batches": batch["processed"]}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Continue where the checkpoint was written."""
        self._resume = {"epoch": int(state_dict["epoch"]), "batches": int(state_dict["batches"])}

    def transfer_batch_to_device(self, batch: Batch, device: torch.device, dataloader_idx: int) -> Batch:
        """Return the batch with its tensors on a device; rigs and names stay."""
        return to_device(batch, device)

    def _rank(self) -> tuple[int, int]:
        return (self.trainer.global_rank, self.trainer.world_size) if self.trainer is not None else (0, 1)
