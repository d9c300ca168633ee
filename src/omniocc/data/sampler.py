"""Samplers: the samples of a process and their order."""

from collections.abc import Iterator, Sequence

import torch
from torch.utils.data import DistributedSampler

# Both derive from DistributedSampler so that Lightning leaves them in place under DDP. Its own would start an
# interrupted epoch from its beginning, and score some test samples twice.


class EpochSampler(DistributedSampler):
    """The training order, a function of (seed, epoch) only, divided among the ranks; it can begin within an epoch.

    Every rank gets the same number of samples; at most `world_size - 1` are not used in an epoch. `len` is always that
    of a whole epoch.

    Args:
        size: number of samples.
        seed: of the order.
        rank: number of this process.
        world_size: number of processes.
        resume_epoch: epoch that was interrupted.
        resume_samples: samples this rank has already seen in it; other epochs are whole.
        scenes: number of samples of each scene, in order; None: all are of one.
        together: samples of one scene that follow one another: what depends on a rig is then computed once for them.
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
    ):
        super().__init__(range(size), world_size, rank, shuffle=True, seed=seed, drop_last=True)  # type: ignore[arg-type]
        self.size = size
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
        return self.size // self.num_replicas


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
