"""Voxel labels that come with a dataset, on its own grid, for any grid of a model."""

from collections.abc import Sequence
from pathlib import Path
from typing import Protocol, cast

from jaxtyping import Int64, UInt8
from torch import Tensor

from omniocc.data.labels.counts import all_frames, count_classes, kept_counts
from omniocc.data.source import BenchmarkFrame, SceneFrames, Unknown
from omniocc.data.store.shard import digest
from omniocc.geometry import Grid, resample
from omniocc.progress import Progress

COUNTED_FRAMES = 1000
"""Frames, evenly spread over the training scenes, from which class weights and the prior are computed."""


class LabelledScene(SceneFrames, Protocol):
    """A scene whose voxel labels come with the dataset."""

    def own_voxels(self, frame: int, unknown: Unknown) -> UInt8[Tensor, "U V W"] | None:
        """Return the class of every cell of the dataset's grid, 255 unknown; None without labels."""
        ...

    def benchmark(self, frame: int) -> BenchmarkFrame | None:
        """Return the truth of one frame as the dataset's protocol scores it; None without labels."""
        ...


class OwnGridLabels:
    """Labels read when they are asked for, and resampled if the model has another grid (`omniocc.geometry.resample`).

    Nothing is prepared: the first step of training does not wait for all frames.

    Args:
        folder: for the counts of classes.
        fingerprint: of the data.
        own: grid of the dataset's labels, ego frame.
        geometry: grid of the model.
        num_classes: number of classes, free included.
        unknown: label of cells that nothing has observed.
    """

    def __init__(
        self, folder: Path, fingerprint: str, own: Grid, geometry: Grid, num_classes: int, unknown: Unknown
    ):  # fmt: skip
        self.folder, self.fingerprint = Path(folder), fingerprint
        self.own, self.geometry = own, geometry
        self.num_classes = num_classes
        self.unknown: Unknown = unknown

    def prepare(self, scenes: Sequence[SceneFrames]) -> None:
        """Do nothing: the labels are there."""

    def read(self, scene: SceneFrames, frame: int) -> UInt8[Tensor, "X Y Z"] | None:
        """Return the class of every cell of the model's grid; unknown outside of the dataset's."""
        labels = cast(LabelledScene, scene).own_voxels(frame, self.unknown)
        return None if labels is None else resample(labels, self.own, self.geometry)

    def benchmark(self, scene: SceneFrames, frame: int) -> BenchmarkFrame | None:
        """Return the truth on the dataset's own grid."""
        return cast(LabelledScene, scene).benchmark(frame)

    def counts(self, scenes: Sequence[SceneFrames]) -> Int64[Tensor, "C X Y Z"]:
        """Return in how many frames each cell has each class, over at most `COUNTED_FRAMES` frames; kept on disk."""
        frames = all_frames(scenes)
        chosen = frames[:: -(-len(frames) // COUNTED_FRAMES) or 1]
        key = digest([self.fingerprint, repr(self.geometry), self.unknown, [scene.name for scene in scenes]])[:12]
        shape = (self.num_classes, *self.geometry.shape)

        def count() -> Int64[Tensor, "C X Y Z"]:
            with Progress(f"classes of {len(chosen)} of {len(frames)} frames", len(chosen)) as progress:
                return count_classes(self, chosen, self.num_classes, self.geometry.shape, progress)

        return kept_counts(self.folder / f"counts-{key}.zst", shape, count)
