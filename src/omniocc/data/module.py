"""Datasets and loaders for training, validation and test."""

from typing import Any

from jaxtyping import Int64
from lightning.pytorch import LightningDataModule
from torch import Tensor, device
from torch.utils.data import DataLoader

from omniocc.batch import Batch
from omniocc.data.dataset import Extras, WindowDataset, collate
from omniocc.data.labels.voxels import Unknown, VoxelCache
from omniocc.data.recording.pool import limit_threads
from omniocc.data.sampler import EpochSampler, RankSampler
from omniocc.data.source.virtual import SPLITS, Split, VirtualWorld
from omniocc.geometry import Grid


class OccupancyData(LightningDataModule):
    """Batches of windows of recorded frames with voxels of one geometry.

    The order of training is a function of (seed, epoch). A run that resumes from a checkpoint written after any batch
    or validation sees exactly the batches that were left. (Of checkpoints written in `on_train_epoch_end` that holds
    with `max_epochs` only: with `max_steps`, Lightning 2.6 counts such an epoch twice and skips one order.)

    Args:
        world: the recorded scenes; rendered when missing.
        geometry: grid of the voxel labels.
        window: frames per sample, the newest included.
        batch_size: samples per process and step.
        num_workers: loader processes; 0 loads in the training process.
        seed: of the order of training samples.
        unknown: what cells without points are: `free` (the paper) or `unobserved` (255 where no sensor looked).
    """

    def __init__(
        self,
        world: VirtualWorld,
        geometry: Grid,
        window: int,
        batch_size: int,
        num_workers: int,
        seed: int,
        unknown: Unknown = "free",
    ):
        super().__init__()
        if batch_size < 1 or num_workers < 0:
            raise ValueError(
                f"batch_size must be at least 1 and num_workers at least 0, got {batch_size} and {num_workers}"
            )
        self.world = world
        self.geometry = geometry
        self.window = window
        self.batch_size = batch_size
        self.num_workers = num_workers
        self.seed = seed
        self.voxels = VoxelCache(world.folder, geometry, unknown)
        self.extras = Extras()
        self._datasets: dict[Split, WindowDataset] = {}
        self._resume = {"epoch": 0, "batches": 0}

    def prepare_data(self) -> None:
        """Render scenes and vote for voxels that are missing."""
        self.world.prepare()
        scenes = [scene for split in SPLITS for scene in self.world.readers(split)]
        self.voxels.prepare(scenes, self.world.workers)

    def setup(self, stage: str | None = None) -> None:
        """Open the three splits; `prepare_data` has been called, here or in another process."""
        for split in SPLITS:
            readers = self.world.readers(split)
            self._datasets.setdefault(split, WindowDataset(readers, self.voxels, self.window, self.extras))

    def read_also(self, extras: Extras) -> None:
        """What samples hold beside images and labels, from the next `setup` on."""
        self.extras = extras
        self._datasets = {}

    def dataset(self, split: Split) -> WindowDataset:
        """The samples of a split, after `setup`."""
        return self._datasets[split]

    def voxel_counts(self) -> Int64[Tensor, "C X Y Z"]:
        """How often each class stood in each cell of the training set; counted once, then read from disk."""
        return self.voxels.counts(self.dataset("train").scenes, self.world.fingerprint)

    def train_dataloader(self) -> DataLoader[Batch]:
        """Shuffled; the last incomplete batch of an epoch is left out."""
        dataset = self.dataset("train")
        done = self._resume["batches"] * self.batch_size
        sampler = EpochSampler(len(dataset), self.seed, *self._rank(), self._resume["epoch"], done)
        if len(sampler) < self.batch_size:
            raise ValueError(
                f"{len(sampler)} training samples per process are less than one batch of {self.batch_size}: "
                "render more scenes or lower batch_size"
            )
        return self._loader(dataset, sampler, drop_last=True)

    def val_dataloader(self) -> DataLoader[Batch]:
        """In order, every sample once over all ranks."""
        return self._in_order("val")

    def test_dataloader(self) -> DataLoader[Batch]:
        """In order, every sample once over all ranks."""
        return self._in_order("test")

    def state_dict(self) -> dict[str, Any]:
        """The epoch and how many of its batches are done, for a resumed run."""
        if self.trainer is None:
            return dict(self._resume)
        loop = self.trainer.fit_loop
        epoch, batch = (
            loop.epoch_progress.state_dict()["current"],
            loop.epoch_loop.batch_progress.state_dict()["current"],
        )
        if epoch["started"] == epoch["processed"]:  # between two epochs
            return {"epoch": epoch["processed"], "batches": 0}
        if (
            batch["processed"] >= self.trainer.num_training_batches
        ):  # after the last batch, before the epoch counts as done
            return {"epoch": epoch["processed"] + 1, "batches": 0}
        return {"epoch": epoch["processed"], "batches": batch["processed"]}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Go on where the checkpoint was written."""
        self._resume = {"epoch": int(state_dict["epoch"]), "batches": int(state_dict["batches"])}

    def transfer_batch_to_device(self, batch: Batch, device: device, dataloader_idx: int) -> Batch:
        """Tensors move; rigs and names stay."""
        tensors = {name: item for name, item in batch._asdict().items() if isinstance(item, Tensor)}
        return batch._replace(**{name: item.to(device, non_blocking=True) for name, item in tensors.items()})

    def _in_order(self, split: Split) -> DataLoader[Batch]:
        dataset = self.dataset(split)
        return self._loader(dataset, RankSampler(len(dataset), *self._rank()), drop_last=False)

    def _rank(self) -> tuple[int, int]:
        return (self.trainer.global_rank, self.trainer.world_size) if self.trainer is not None else (0, 1)

    def _loader(
        self, dataset: WindowDataset, sampler: EpochSampler | RankSampler, drop_last: bool
    ) -> DataLoader[Batch]:
        return DataLoader(
            dataset,
            self.batch_size,
            sampler=sampler,
            drop_last=drop_last,
            collate_fn=collate,
            num_workers=self.num_workers,
            worker_init_fn=limit_threads,
            persistent_workers=self.num_workers > 0,
            # a plain fork copies the locks other threads (W&B, OpenMP) hold just then: the loader would wait forever
            multiprocessing_context="forkserver" if self.num_workers else None,
        )
