"""Datasets of semantic scene completion: labels are voxels of .2 m ahead of a velodyne (SemanticKITTI, SSCBench)."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import ClassVar, Generic, TypeVar

import numpy as np
import torch
from jaxtyping import UInt8
from torch import Tensor

from omniocc.camera import Equirectangular, Rig
from omniocc.classes import UNKNOWN, ClassTable
from omniocc.data.formats.kitti import CELL_M, LOW_M, SHAPE, classes_by_id, read_voxels, write_prediction
from omniocc.data.formats.scene import DatasetScene
from omniocc.data.labels.own_grid import OwnGridLabels
from omniocc.data.source import SPLITS, Benchmark, BenchmarkFrame, SourceSpec, Split, Unknown
from omniocc.geometry import Cuboid, Grid

ROAD_Z_M = -1.73
PARTS = (("12.8m", (0.0, 12.8), (-6.4, 6.4)), ("25.6m", (0.0, 25.6), (-12.8, 12.8)))
"""Nearer parts in which methods are compared as well, beside all 51.2 m."""
RANGE_EDGES_M = (0.0, 12.8, 25.6, 51.2)
INTERVAL_S = 0.5

Scene = TypeVar("Scene", bound="CompletionScene")


def voxel_grid(first_release: bool = False) -> Cuboid:
    """Return the voxels, velodyne frame; those of SemanticKITTI's first release lie one cell higher in the files."""
    low = (LOW_M[0], LOW_M[1], LOW_M[2] - CELL_M * first_release)
    ends = [(start, start + cells * CELL_M) for start, cells in zip(low, SHAPE, strict=True)]
    return Cuboid(SHAPE, *[(round(start, 6), round(end, 6)) for start, end in ends])


class CompletionSource(ABC, Generic[Scene]):
    """A source (`SceneSource`) of sequences; the ego frame is that of the velodyne.

    Args:
        root: folder of the dataset.
        sequences: numbers of the sequences of train, val and test.
        image_width: of the images that the model gets, px; the height follows, a multiple of 8.
        panorama: width and height (px), upper and lower edge (deg) of the panoramas of ranges.
        cache: folder for what is computed once; None: `omniocc` in root.

    Raises:
        ValueError: if a split or the width is impossible.
    """

    classes: ClassVar[ClassTable]

    def __init__(
        self, root: str, sequences: Mapping[Split, Sequence[str]], image_width: int,
        panorama: tuple[int, int, float, float], cache: str | None,
    ):  # fmt: skip
        if image_width < 8 or set(sequences) != set(SPLITS):
            given = f"{image_width} and {dict(sequences)}"
            raise ValueError(f"image_width must be at least 8 and sequences need {', '.join(SPLITS)}, got {given}")
        self.sequences = {split: [str(number).zfill(2) for number in sequences[split]] for split in SPLITS}
        self.root, self.image_width = root, image_width
        self.panorama = Equirectangular(*panorama)
        self.folder = Path(root, "omniocc") if cache is None else Path(cache)

    @property
    def grid(self) -> Cuboid:
        """Return the voxels of the labels."""
        return voxel_grid()

    @property
    def spec(self) -> SourceSpec:
        """Return classes, bands and the protocol: cells that are not invalid, in 12.8, 25.6 and 51.2 m."""
        benchmark = Benchmark(self.grid, parts=PARTS)
        return SourceSpec(self.classes, RANGE_EDGES_M, INTERVAL_S, ROAD_Z_M, None, benchmark)

    @property
    @abstractmethod
    def fingerprint(self) -> str:
        """See `SceneSource`."""

    @abstractmethod
    def sequence(self, name: str) -> Scene:
        """Return a sequence by its number."""

    def scenes(self, split: Split) -> Sequence[Scene]:
        """Return the sequences of a split."""
        return [self.all_scenes[name] for name in self.sequences[split]]

    def labels(self, geometry: Grid, unknown: Unknown) -> OwnGridLabels:
        """Return the voxels in a grid; what `unobserved` adds to the benchmark's unknown cells, the scenes tell.

        Raises:
            ValueError: for `unseen`: there is no mask of what the cameras see.
        """
        if unknown == "unseen":
            raise ValueError("data.unknown=unseen: there is no mask of what cameras see; choose free or unobserved")
        return OwnGridLabels(self.folder, self.fingerprint, self.grid, geometry, self.classes.num_classes, unknown)

    @cached_property
    def all_scenes(self) -> dict[str, Scene]:
        """Return the sequences of all splits by number."""
        return {name: self.sequence(name) for split in SPLITS for name in self.sequences[split]}

    @property
    def frames(self) -> list[list[object]]:
        """Return split, number and frames of every sequence, and whether labels are there, for fingerprints."""
        return [[split, scene.name, scene.numbers, scene.labelled] for split in SPLITS for scene in self.scenes(split)]


class CompletionScene(DatasetScene):
    """The frames of one sequence that have voxels: every fifth of KITTI's."""

    ids: ClassVar[dict[int, tuple[int, ...]]]
    """Ids in files of each class, that of submissions first."""

    @property
    @abstractmethod
    def numbers(self) -> list[int]:
        """Return the numbers of the frames, as in the names of files."""

    @property
    @abstractmethod
    def labelled(self) -> bool:
        """Return whether voxel labels are there."""

    @property
    @abstractmethod
    def rig(self) -> Rig:
        """Return the cameras, the same in every frame."""

    @abstractmethod
    def own_voxels(self, frame: int, unknown: Unknown) -> UInt8[Tensor, "X Y Z"] | None:
        """Return the class of every cell; None where labels are secret."""

    def __len__(self) -> int:
        return len(self.numbers)

    @cached_property
    def table(self) -> np.ndarray:
        """Return the class of every id in files."""
        return classes_by_id(self.ids)

    @cached_property
    def rigs(self) -> tuple[Rig, ...]:
        """Return the cameras of every frame."""
        return (self.rig,) * len(self)

    def voxels_of(self, path: Path) -> UInt8[np.ndarray, "X Y Z"]:
        """Return the classes of a `.label` file of voxels, 0 empty, 255 those that do not count."""
        return read_voxels(path, self.table)

    def benchmark(self, frame: int) -> BenchmarkFrame | None:
        """Return the voxels; all count that are not unknown. None where labels are secret."""
        voxels = self.own_voxels(frame, "free")
        return None if voxels is None else BenchmarkFrame(voxels)

    def prediction_file(self, frame: int) -> str:
        """Return the place of a frame's file in a submission."""
        return f"sequences/{self.name}/predictions/{self.numbers[frame]:06d}.label"

    def write_prediction(self, path: Path, classes: UInt8[np.ndarray, "X Y Z"]) -> None:
        """Write classes as ids of 16 bits."""
        write_prediction(path, classes, self.ids)

    def read_prediction(self, path: Path) -> UInt8[np.ndarray, "X Y Z"]:
        """Return the classes of a file of ids; those that do not count are empty."""
        classes = self.voxels_of(path)
        return np.where(classes == UNKNOWN, 0, classes).astype(np.uint8)


def unknown_where(classes: UInt8[np.ndarray, "X Y Z"], cells: np.ndarray) -> UInt8[Tensor, "X Y Z"]:
    """Return classes that are unknown in these cells."""
    return torch.from_numpy(np.where(cells, np.uint8(UNKNOWN), classes))
