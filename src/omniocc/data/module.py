"""Datasets and loaders for training, validation and test; `omniocc.train.data_module` hands them to Lightning."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cached_property

import torch
from jaxtyping import Int64
from torch import Tensor
from torch.utils.data import DataLoader, DistributedSampler

from omniocc.batch import Batch
from omniocc.bounds import Count, CountOrNone, Number, Size
from omniocc.data.dataset import Needs, WindowDataset, collate
from omniocc.data.labels.counts import kept_counts
from omniocc.data.labels.ray_votes import RAY_VERSION, RayVotes, count_rays
from omniocc.data.labels.survival import lost_line
from omniocc.data.labels.voxels import VoxelCache
from omniocc.data.loader import Loader
from omniocc.data.origins import Origins
from omniocc.data.source import (
    SPLITS,
    Ignore,
    MadeScenes,
    SceneFrames,
    SceneSource,
    SourceSpec,
    Split,
    VoxelLabels,
    has_poses,
)
from omniocc.data.store.reader import SceneReader
from omniocc.data.store.shard import digest
from omniocc.errors import UserError, moved_by
from omniocc.geometry import Grid
from omniocc.loss import RayWindow, TotalLoss
from rayiou.directions import rays_around

# Both derive from DistributedSampler so that Lightning leaves them in place under DDP. Its own would start an
# interrupted epoch from its beginning, and score some test samples twice.


class EpochSampler(DistributedSampler):
    """The training order, a function of (seed, epoch) only, divided among the ranks; it can begin within an epoch.

    Every rank gets the same number of samples, in whole steps; the rest of an epoch is left out. `len` is always the
    number in a whole epoch.

    Args:
        size: number of samples.
        seed: of the order.
        rank: number of this process.
        world_size: number of processes.
        resume_epoch: epoch that was interrupted.
        resume_samples: samples this rank has already seen in it; other epochs are whole.
        scenes: number of samples of each scene, in order; None: all are of one.
        together: samples of one scene that follow one another: what depends on a rig is then computed once for them.
        of_step: samples of a rank in a step of the optimiser.
    """

    def __init__(
        self,
        size: int,
        seed: int,
        rank: int = 0,
        world_size: int = 1,
        resume_epoch: int = 0,
        resume_samples: int = 0,
        scenes: Sequence[int] | None = None,
        together: int = 1,
        of_step: int = 1,
    ):
        super().__init__(range(size), world_size, rank, shuffle=True, seed=seed, drop_last=True)  # type: ignore[arg-type]
        self.length = size // world_size // of_step * of_step
        self.scenes, self.together = tuple(scenes or [size]), together
        self.resume_epoch = resume_epoch
        self.resume_samples = resume_samples
        self.epoch = resume_epoch  # workers fetch ahead before `set_epoch` is called

    def __iter__(self) -> Iterator[int]:
        generator = torch.Generator().manual_seed(self.seed * 1_000_003 + self.epoch)
        order = shuffled(self.scenes, self.together, generator)
        samples = order[self.rank :: self.num_replicas][: len(self)]
        return iter(samples[self.resume_samples :] if self.epoch == self.resume_epoch else samples)

    def __len__(self) -> int:
        return self.length


def shuffled(scenes: Sequence[int], together: int, generator: torch.Generator) -> list[int]:
    """Return all samples in a random order in which `together` of a scene, or the rest of it, follow one another.

    `scenes` are the numbers of samples of the scenes, which come one after the other.
    """
    if together == 1:
        return torch.randperm(sum(scenes), generator=generator).tolist()
    groups, first = [], 0
    for size in scenes:
        samples = (first + torch.randperm(size, generator=generator)).tolist()
        groups += [samples[k : k + together] for k in range(0, size, together)]
        first += size
    return [sample for k in torch.randperm(len(groups), generator=generator).tolist() for sample in groups[k]]


class RankSampler(DistributedSampler):
    """Validation and test: every sample exactly once over all ranks, in order.

    Each rank has frames that follow one another, so that volumes of the past can be used again.
    """

    def __init__(self, size: int, rank: int = 0, world_size: int = 1):
        super().__init__(range(size), world_size, rank, shuffle=False)  # type: ignore[arg-type]
        self._samples = range(rank * size // world_size, (rank + 1) * size // world_size)

    def __iter__(self) -> Iterator[int]:
        return iter(self._samples)

    def __len__(self) -> int:
        return len(self._samples)


class OccupancyData:
    """Batches of windows of recorded frames with voxels of one geometry.

    The order of training is a function of (seed, epoch).

    Args:
        source: of the scenes and their labels.
        num_classes: number of classes of the model, free included; equal to that of the source.
        geometry: grid of the voxel labels.
        window: frames per sample, the newest included.
        batch_size: samples per process and step.
        num_workers: loader processes; 0 loads in the training process.
        seed: of the order of training samples.
        ignore: cells that are unknown (255): `none` (the paper), `unobserved` (those without points that no ray of a
            sensor crossed) or `unseen` (those that no camera sees, if the dataset has a mask of these).
        samples_per_scene: training frames of a scene that follow one another; where every scene has a rig of its own,
            two or more save time.
        range_edges_m: ends of the distance bands of scores; LiDAR hits at the last of them or beyond count as free.
            None: those of the source.
        ray_azimuths: azimuths of the rays of voxel RayIoU at the 39 public elevations; None: the 360 public ones.

    Raises:
        ValueError: if a number is too small.
    """

    def __init__(
        self,
        source: SceneSource,
        num_classes: Size,
        geometry: Grid,
        window: Count,
        batch_size: Number,
        num_workers: CountOrNone,
        seed: int,
        ignore: Ignore = "none",
        samples_per_scene: Number = 1,
        range_edges_m: Sequence[float] | None = None,
        ray_azimuths: Number | None = None,
    ):
        if ray_azimuths is not None and ray_azimuths < 1:
            raise ValueError(f"ray_azimuths must be at least 1, got {ray_azimuths}")
        if min(batch_size, samples_per_scene) < 1 or num_workers < 0:
            given = f"{batch_size}, {samples_per_scene} and {num_workers}"
            raise ValueError(f"batch_size and samples_per_scene must be at least 1, num_workers 0, got {given}")
        self.source = source
        self.num_classes = num_classes
        self.geometry = geometry
        self.window = window
        self.batch_size = batch_size
        self.num_workers = num_workers
        self.seed = seed
        self.ignore: Ignore = ignore
        self.samples_per_scene = samples_per_scene
        self.range_edges_m = range_edges_m
        self.ray_azimuths = ray_azimuths
        self.needs: dict[Split, Needs] = dict.fromkeys(SPLITS, Needs())
        self.origins: Origins = "own"
        self.splits: Sequence[Split] = SPLITS
        self._datasets: dict[Split, WindowDataset] = {}

    def prepare_data(self) -> None:
        """Make the scenes and labels that are missing.

        Raises:
            UserError: if the source has another number of classes than the model.
        """
        source = self.source
        with moved_by("paths.data"):
            if isinstance(source, MadeScenes) and self.splits != SPLITS:
                for split in self.splits:
                    source.made(split, list(source.planned(split)))
            else:
                source.prepare()
        self.check_classes()
        with moved_by("data.source.cache"):
            self.voxels.prepare([scene for split in self.splits for scene in source.scenes(split)])

    @cached_property
    def spec(self) -> SourceSpec:
        """Return the facts about the source, with the distance bands and rays that were asked for.

        Raises:
            UserError: if the bands are fewer than one or do not increase.
        """
        spec = self.source.spec
        if self.ray_azimuths is not None:
            spec = replace(spec, ray_directions=rays_around(self.ray_azimuths))
        if self.range_edges_m is None:
            return spec
        try:
            return replace(spec, range_edges_m=tuple(map(float, self.range_edges_m)))
        except ValueError as error:
            raise UserError(f"data.range_edges_m={list(self.range_edges_m)}: {error}") from error

    @cached_property
    def voxels(self) -> VoxelLabels:
        """Return the source's labels of the grid."""
        return self.source.labels(self.geometry, self.ignore)

    def remarks(self) -> Iterator[str]:
        """Yield a line where scores end before the grid, labels are lost, poses lack or a LiDAR leaves cells unseen.

        `prepare_data` has been called.

        Raises:
            DataError: naming a damaged file of the first training frame.
        """
        reach_m = self.spec.reach_m
        if isinstance(self.voxels, VoxelCache) and self.voxels.beyond is not None:
            yield (
                "the grid reaches farther than the recorded points of these scenes: cells beyond are unknown, neither "
                "trained nor scored"
            )
        elif self.spec.benchmark is None and self.geometry.reaches_beyond(reach_m):
            yield (
                f"LiDAR hits count as free from {reach_m:g} m on, but the grid reaches farther: "
                f"data.range_edges_m=[0,{reach_m:g},<end of the grid>] scores all of it"
            )
        first = [scene for scene in self.source.scenes("train") if len(scene)][:1]
        yield from filter(None, (lost_line(scene, self.voxels, self.geometry) for scene in first))
        if self.window > 1 and not all(map(has_poses, first)):
            yield "the frames have no poses: past ones are fused as if the car stood still; choose model/temporal=none"
        scenes = [scene for scene in first if isinstance(scene, SceneReader)]
        if self.ignore == "none" and any("log" in scene.meta.get("facts", {}) for scene in scenes):
            yield (
                "cells without points count as free, but a single LiDAR does not see all of them: "
                "data.ignore=unobserved leaves those out that no ray has crossed"
            )

    def check_classes(self) -> None:
        """Compare the number of classes with the source's; raise UserError if they differ."""
        names = self.spec.classes.names
        if len(names) != self.num_classes:
            raise UserError(
                f"data.num_classes={self.num_classes}, but this source has {len(names)} classes "
                f"({', '.join(names)}): set data.num_classes={len(names)}"
            )

    def setup(self) -> None:
        """Open the splits; `prepare_data` has been called, here or in another process."""
        spec = self.spec
        own_rays, grid = spec.lidar_directions is None, spec.scored_grid(self.geometry)
        for split in self.splits:
            scenes, needs = self.source.scenes(split), self.needs[split]
            made = WindowDataset(scenes, self.voxels, self.window, needs, own_rays, self.origins, scored_grid=grid)
            self._datasets.setdefault(split, made)

    def restrict_to(self, split: Split) -> None:
        """Make and open the scenes of one split alone, from the next `prepare_data` on."""
        self.splits = (split,)

    def set_needs(self, train: Needs, test: Needs) -> None:
        """Set what samples hold from the next `setup` on: those of training, and those of validation and test."""
        self.needs = {"train": train, "val": test, "test": test}
        self._datasets = {}

    def set_ray_origins(self, origins: Origins) -> None:
        """Set from where the rays of RayIoU start, from the next `setup` on."""
        self.origins = origins
        self._datasets = {}

    def dataset(self, split: Split) -> WindowDataset:
        """Return the samples of a split, after `setup`."""
        return self._datasets[split]

    def ray_votes(self, window: RayWindow) -> RayVotes:
        """Return labels that measured rays vote; those of training frames that are missing are made now."""
        workers, source = getattr(self.voxels, "workers", 0), self.source
        votes = RayVotes(source.folder, self.geometry, window, source.fingerprint, self.num_classes, workers)
        with moved_by("data.source.cache"):
            votes.prepare(source.scenes("train"))
        return votes

    def voxel_counts(self, loss: TotalLoss | None = None) -> Int64[Tensor, "C X Y Z"]:
        """Return how often each cell has each class in training frames, in the labels from which a loss learns.

        These are voxels (also without a loss), voxels that rays vote, or the rays themselves (`count_rays`).
        """
        window, scenes = None if loss is None else loss.rays, self.dataset("train").scenes
        with moved_by("data.source.cache"):
            if window is not None and loss is not None:
                return self.ray_votes(window).counts(scenes) if loss.needs_voxels else self._ray_counts(window, scenes)
            return self.voxels.counts(scenes)

    def _ray_counts(self, window: RayWindow, scenes: Sequence[SceneFrames]) -> Int64[Tensor, "C X Y Z"]:
        names, shape = [scene.name for scene in scenes], (self.num_classes, *self.geometry.shape)
        which = [repr(self.geometry), sorted(window.frames), window.classes]
        key = digest([RAY_VERSION, self.source.fingerprint, names, *which])
        path = self.source.folder / f"ray-counts-{key[:12]}.zst"
        return kept_counts(path, shape, lambda: count_rays(scenes, self.geometry, window, self.num_classes))

    def train_dataloader(
        self, rank: int = 0, world_size: int = 1, accumulated: int = 1, epoch: int = 0, batches: int = 0
    ) -> DataLoader[Batch]:
        """Return the shuffled loader; the last incomplete step of an epoch is left out.

        Every step is of one epoch alone: a checkpoint between two epochs would lose gradients that are accumulated.

        Args:
            rank: number of this process.
            world_size: number of processes.
            accumulated: batches of a step.
            epoch: that was interrupted.
            batches: of it that were used before.

        Raises:
            UserError: if a process has fewer samples than a step.
        """
        dataset = self.dataset("train")
        sizes = [len(scene) for scene in dataset.scenes]
        resume, of_step = (epoch, batches * self.batch_size), self.batch_size * accumulated
        sampler = EpochSampler(
            len(dataset), self.seed, rank, world_size, *resume, sizes, self.samples_per_scene, of_step
        )
        if not len(sampler):
            raise UserError(
                f"{len(dataset) // world_size} training samples per process are less than the {of_step} of a "
                "step: use more scenes, a lower data.batch_size or a lower trainer.accumulate_grad_batches"
            )
        return self._loader(dataset, sampler)

    def in_order(self, split: Split, rank: int = 0, world_size: int = 1) -> DataLoader[Batch]:
        """Return the loader of a split in order, every sample once over all ranks."""
        dataset = self.dataset(split)
        return self._loader(dataset, RankSampler(len(dataset), rank, world_size))

    def _loader(self, dataset: WindowDataset, sampler: EpochSampler | RankSampler) -> DataLoader[Batch]:
        return Loader(
            dataset,
            self.batch_size,
            self.num_workers,
            collate,
            sampler=sampler,
            persistent_workers=self.num_workers > 0,
        )
