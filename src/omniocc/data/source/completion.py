"""Datasets of semantic scene completion: labels are voxels of .2 m ahead of a velodyne (SemanticKITTI, SSCBench)."""

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import ClassVar, TypeVar

import numpy as np
import torch
from jaxtyping import UInt8
from torch import Tensor

from omniocc.classes import UNKNOWN
from omniocc.data.formats.kitti import CELL_M, LOW_M, SHAPE, classes_by_id, read_voxels, write_prediction
from omniocc.data.source import SPLITS, Benchmark, SourceSpec, Split
from omniocc.data.source.own_grid import OwnGridScene, OwnGridSource
from omniocc.geometry import Cuboid

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


class CompletionSource(OwnGridSource[Scene]):
    """A source (`SceneSource`) of numbered sequences in the frame of the velodyne; see `OwnGridSource`."""

    def __init__(
        self, root: str, sequences: Mapping[Split, Sequence[str]], image_width: int,
        panorama: tuple[int, int, float, float], cache: str | None,
    ):  # fmt: skip
        super().__init__(root, sequences, image_width, panorama, cache)
        self.sequences = {split: [name.zfill(2) for name in names] for split, names in self.sequences.items()}

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
    def frames(self) -> list[list[object]]:
        """Return split, number and frames of every sequence, and whether labels are there, for fingerprints."""
        return [[split, scene.name, scene.numbers, scene.labelled] for split in SPLITS for scene in self.scenes(split)]


class CompletionScene(OwnGridScene):
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

    @cached_property
    def table(self) -> np.ndarray:
        """Return the class of every id in files."""
        return classes_by_id(self.ids)

    def voxels_of(self, path: Path) -> UInt8[np.ndarray, "X Y Z"]:
        """Return the classes of a `.label` file of voxels, 0 empty, 255 those that do not count."""
        return read_voxels(path, self.table)

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
