"""Voxel labels of public datasets: their own voxels in any grid of a model, or votes of their points."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from pathlib import Path
from typing import ClassVar, Protocol, cast

from jaxtyping import Int64, UInt8
from torch import Tensor

from omniocc.data.labels.counts import all_frames, count_classes, kept_counts
from omniocc.data.labels.voxels import vote
from omniocc.data.source import BenchmarkFrame, Ignore, SceneFrames, VoxelLabels
from omniocc.data.store.shard import digest
from omniocc.geometry import Grid, resample
from omniocc.progress import Progress


class LabelledScene(SceneFrames, Protocol):
    """A scene whose voxel labels come with the dataset."""

    def own_voxels(self, frame: int, ignore: Ignore) -> UInt8[Tensor, "U V W"] | None:
        """Return the class of every cell of the dataset's grid, 255 unknown; None without labels."""
        ...

    def benchmark(self, frame: int) -> BenchmarkFrame | None:
        """Return the truth of one frame as the dataset's protocol scores it; None without labels."""
        ...


class LazyLabels(ABC):
    """Labels that are made when they are asked for: the first step of training does not wait for all frames.

    Args:
        folder: for the counts of classes.
        fingerprint: of the data.
        geometry: grid of the model.
        num_classes: number of classes, free included.
        ignore: which cells are unknown, such as those that nothing has observed.
    """

    COUNTED: ClassVar[int]
    """Frames, evenly spread over the training scenes, from which class weights and the prior are computed."""

    def __init__(self, folder: Path, fingerprint: str, geometry: Grid, num_classes: int, ignore: Ignore):
        self.folder, self.fingerprint, self.geometry = Path(folder), fingerprint, geometry
        self.num_classes = num_classes
        self.ignore: Ignore = ignore

    def prepare(self, scenes: Sequence[SceneFrames]) -> None:
        """Return at once: nothing is made before it is asked for."""
        del scenes

    @abstractmethod
    def read(self, scene: SceneFrames, frame: int) -> UInt8[Tensor, "X Y Z"] | None:
        """Return the class of every cell of the model's grid, 255 unknown; None without labels."""

    def counts(self, scenes: Sequence[SceneFrames]) -> Int64[Tensor, "C X Y Z"]:
        """Return in how many of at most `COUNTED` frames each cell has each class; kept on disk."""
        frames = all_frames(scenes)
        chosen = frames[:: max(1, -(-len(frames) // self.COUNTED))]
        key = digest([self.fingerprint, repr(self.geometry), self.ignore, [scene.name for scene in scenes]])[:12]
        shape = (self.num_classes, *self.geometry.shape)

        def count() -> Int64[Tensor, "C X Y Z"]:
            with Progress(f"classes of {len(chosen)} of {len(frames)} frames", len(chosen)) as progress:
                return count_classes(cast(VoxelLabels, self), chosen, self.num_classes, self.geometry.shape, progress)

        return kept_counts(self.folder / f"counts-{key}.zst", shape, count)


class OwnGridLabels(LazyLabels):
    """Labels of the dataset's own grid, resampled if the model has another (`rayiou.resample`).

    Args:
        folder: see `LazyLabels`.
        fingerprint: see `LazyLabels`.
        own: grid of the dataset's labels, ego frame.
        geometry: see `LazyLabels`.
        num_classes: see `LazyLabels`.
        ignore: see `LazyLabels`.
    """

    COUNTED = 1000

    def __init__(self, folder: Path, fingerprint: str, own: Grid, geometry: Grid, num_classes: int, ignore: Ignore):
        super().__init__(folder, fingerprint, geometry, num_classes, ignore)
        self.own = own

    def read(self, scene: SceneFrames, frame: int) -> UInt8[Tensor, "X Y Z"] | None:
        """Return the class of every cell of the model's grid; unknown outside of the dataset's."""
        labels = cast(LabelledScene, scene).own_voxels(frame, self.ignore)
        return None if labels is None else resample(labels, self.own, self.geometry)

    def benchmark(self, scene: SceneFrames, frame: int) -> BenchmarkFrame | None:
        """Return the truth on the dataset's own grid."""
        return cast(LabelledScene, scene).benchmark(frame)


class VotedLabels(LazyLabels):
    """Labels voted by a frame's points in the model's grid, for datasets without voxels of their own."""

    COUNTED = 200

    def read(self, scene: SceneFrames, frame: int) -> UInt8[Tensor, "X Y Z"]:
        """Return the class of every cell, voted by its points."""
        return vote(scene, frame, self.geometry, self.ignore, self.num_classes)

    def benchmark(self, scene: SceneFrames, frame: int) -> None:
        """Return None: scores are computed on these voxels."""
