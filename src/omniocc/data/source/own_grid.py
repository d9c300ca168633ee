"""What sources have in common whose sequences come with voxel labels in a grid of the dataset."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import ClassVar, Generic, TypeVar

import numpy as np
from jaxtyping import UInt8
from torch import Tensor

from omniocc.camera import Equirectangular, Rig
from omniocc.classes import ClassTable
from omniocc.data.formats.dataset_scene import DatasetScene
from omniocc.data.labels.own_grid import OwnGridLabels
from omniocc.data.source import SPLITS, BenchmarkFrame, Ignore, SourceSpec, Split, refuse_unseen
from omniocc.data.store.shard import digest
from omniocc.geometry import Cuboid, Grid

Scene = TypeVar("Scene", bound="OwnGridScene")


class OwnGridSource(ABC, Generic[Scene]):
    """A source (`SceneSource`) of sequences.

    Args:
        root: folder of the dataset.
        sequences: names of the sequences of train, val and test.
        image_width: of the images that the model gets, px; the height follows, a multiple of 8.
        panorama: width and height (px), upper and lower edge (deg) of the panoramas of ranges.
        cache: folder for what is computed once; None: `omniocc` in root.

    Raises:
        ValueError: if a split or the width is impossible.
    """

    classes: ClassVar[ClassTable]

    def __init__(
        self,
        root: str,
        sequences: Mapping[Split, Sequence[str]],
        image_width: int,
        panorama: tuple[int, int, float, float],
        cache: str | None,
    ):
        if image_width < 8 or set(sequences) != set(SPLITS):
            given = f"{image_width} and {dict(sequences)}"
            raise ValueError(f"image_width must be at least 8 and sequences need {', '.join(SPLITS)}, got {given}")
        self.sequences = {split: [str(name) for name in sequences[split]] for split in SPLITS}
        self.root, self.image_width = root, image_width
        self.panorama = Equirectangular(*panorama)
        self.folder = Path(root, "omniocc") if cache is None else Path(cache)

    @property
    @abstractmethod
    def grid(self) -> Cuboid:
        """Return the voxels of the labels."""

    @property
    @abstractmethod
    def spec(self) -> SourceSpec:
        """See `SceneSource`."""

    @property
    def fingerprint(self) -> str:
        """Return a hash of the frames of every sequence, of the rigs and of the size of the panorama."""
        return digest(
            [
                self.frames,
                [scene.rig.fingerprint for scene in self.all_scenes.values()],
                repr(self.panorama),
                self.options,
            ]
        )

    @property
    def options(self) -> list[object]:
        """Return what else the labels and images depend on, for the fingerprint."""
        return []

    @abstractmethod
    def sequence(self, name: str) -> Scene:
        """Return a sequence by its name."""

    def scenes(self, split: Split) -> Sequence[Scene]:
        """Return the sequences of a split."""
        return [self.all_scenes[name] for name in self.names(split)]

    def names(self, split: Split) -> Sequence[str]:
        """Return the names of the sequences of a split."""
        return self.sequences[split]

    def labels(self, geometry: Grid, ignore: Ignore) -> OwnGridLabels:
        """Return the voxels in a grid; what `unobserved` adds to the benchmark's unknown cells, the scenes tell.

        Raises:
            ValueError: for `unseen`: there is no mask of what the cameras see.
        """
        refuse_unseen(ignore)
        return OwnGridLabels(self.folder, self.fingerprint, self.grid, geometry, self.classes.num_classes, ignore)

    @cached_property
    def all_scenes(self) -> dict[str, Scene]:
        """Return the sequences of all splits by name."""
        return {name: self.sequence(name) for split in SPLITS for name in self.names(split)}

    @property
    def frames(self) -> list[list[object]]:
        """Return split, name and frames of every sequence, for fingerprints."""
        return [[split, scene.name, scene.numbers] for split in SPLITS for scene in self.scenes(split)]


class OwnGridScene(DatasetScene):
    """The frames of one sequence that have voxels; the cameras are the same in all of them."""

    @property
    @abstractmethod
    def numbers(self) -> Sequence[int | str]:
        """Return the numbers or names of the frames in the files."""

    @property
    @abstractmethod
    def rig(self) -> Rig:
        """Return the cameras, the same in every frame."""

    @abstractmethod
    def own_voxels(self, frame: int, ignore: Ignore) -> UInt8[Tensor, "X Y Z"] | None:
        """Return the class of every cell; None where labels are secret."""

    def __len__(self) -> int:
        return len(self.numbers)

    @cached_property
    def rigs(self) -> tuple[Rig, ...]:
        """Return the cameras of every frame."""
        return (self.rig,) * len(self)

    def benchmark(self, frame: int) -> BenchmarkFrame | None:
        """Return the voxels; all count that are not unknown. None where labels are secret."""
        voxels = self.own_voxels(frame, "none")
        return None if voxels is None else BenchmarkFrame(voxels)


def mirrored(cells: np.ndarray) -> np.ndarray:
    """Return cells with y turned from right to left, or back; azimuths of a cylinder turn as y does."""
    return np.ascontiguousarray(cells[:, ::-1])


def standing(frames: int) -> np.ndarray:
    """Return equal poses, (frames, 4, 4), for a dataset that has none: its history can't be fused."""
    return np.tile(np.eye(4), (frames, 1, 1))
