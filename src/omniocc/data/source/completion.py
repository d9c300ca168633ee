"""Datasets of semantic scene completion: labels are voxels of .2 m ahead of a velodyne (SemanticKITTI, SSCBench)."""

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar, NamedTuple, TypeVar, cast

import numpy as np
import torch
from jaxtyping import UInt8
from torch import Tensor

from omniocc.classes import UNKNOWN
from omniocc.data.formats.files import class_table, map_classes, read_array
from omniocc.data.formats.kitti import CELL_M, LOW_M, SHAPE, classes_by_id, write_prediction
from omniocc.data.source import SPLITS, Benchmark, PredictionReader, SourceSpec, Split, SubmittedScene
from omniocc.data.source.own_grid import OwnGridScene, OwnGridSource
from omniocc.data.spacing import evenly_spaced
from omniocc.geometry import Cuboid

ROAD_Z_M = -1.73
PARTS = (("12.8m", (0.0, 12.8), (-6.4, 6.4)), ("25.6m", (0.0, 25.6), (-12.8, 12.8)))
"""Nearer parts in which methods are compared as well, beside all 51.2 m."""
RANGE_EDGES_M = (0.0, 12.8, 25.6, 51.2)
INTERVAL_S = 0.5
LOOKED_AT = 20
"""Files of a submission, evenly spread, from whose values it is decided how all of them number classes and cells."""

Scene = TypeVar("Scene", bound="CompletionScene")


def voxel_grid(first_release: bool = False) -> Cuboid:
    """Return the voxels, velodyne frame; those of SemanticKITTI's first release lie one cell higher in the files."""
    low = (LOW_M[0], LOW_M[1], LOW_M[2] - CELL_M * first_release)
    ends = [(start, start + cells * CELL_M) for start, cells in zip(low, SHAPE, strict=True)]
    return Cuboid(SHAPE, *[(round(start, 6), round(end, 6)) for start, end in ends])


class Numbering(NamedTuple):
    """How the files of a submission number classes and cells.

    Attributes:
        training_ids: whether classes are those of training, 1 car to 19 traffic-sign, in place of the ids of the files.
        cells_up: by how many cells the labels lie higher in their files than predictions in those of the submission.
    """

    training_ids: bool = False
    cells_up: int = 0


class CompletionSource(OwnGridSource[Scene]):
    """A source (`SceneSource`) of numbered sequences in the frame of the velodyne; see `OwnGridSource`."""

    def __init__(
        self,
        root: str,
        sequences: Mapping[Split, Sequence[str]],
        image_width: int,
        panorama: tuple[int, int, float, float],
        cache: str | None,
    ):
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

    def prediction_reader(self, files: Sequence[tuple[SubmittedScene, int, Path]]) -> tuple[PredictionReader, str]:
        """Return what reads the files of a submission, and a line on how they number classes and cells.

        Args:
            files: scene, number of the frame and file of every prediction; the frames have labels.

        Raises:
            DataError: naming a damaged file.
        """
        looked_at = cast(Sequence[Any], [files[place] for place in evenly_spaced(len(files), LOOKED_AT)])
        numbering = numbering_of(looked_at)

        def read(scene: SubmittedScene, path: Path) -> UInt8[np.ndarray, "X Y Z"]:
            return cast(CompletionScene, scene).read_prediction(path, numbering)

        classes = "1 is car, as in training" if numbering.training_ids else "10 is car, as in the dataset's files"
        release = "today's release of the voxels" if numbering.cells_up else "the first release of the voxels"
        cells = f"; cells lie as in {release}" if any(scene.cells_up for scene, _, _ in looked_at) else ""
        return read, f"predictions: class {classes}{cells}"

    @property
    def frames(self) -> list[list[object]]:
        """Return split, number and frames of every sequence, and whether labels are there, for fingerprints."""
        return [[split, scene.name, scene.numbers, scene.labelled] for split in SPLITS for scene in self.scenes(split)]


class CompletionScene(OwnGridScene):
    """The frames of one sequence that have voxels: every fifth of KITTI's."""

    ids: ClassVar[dict[int, tuple[int, ...]]]
    """Ids in files of each class, that of submissions first."""

    @property
    def cells_up(self) -> int:
        """Return by how many cells the voxels lie higher in the files of this copy than in those of today's release."""
        return 0

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
        return map_classes(read_array(path, "<u2", SHAPE), self.table, path)

    def prediction_file(self, frame: int) -> str:
        """Return the place of a frame's file in a submission."""
        return f"sequences/{self.name}/predictions/{self.numbers[frame]:06d}.label"

    def write_prediction(self, path: Path, classes: UInt8[np.ndarray, "X Y Z"]) -> None:
        """Write classes as ids of 16 bits, in the cells of today's release, with which the benchmark compares them."""
        write_prediction(path, moved_up(classes, -self.cells_up), self.ids)

    def read_prediction(self, path: Path, numbering: Numbering | None = None) -> UInt8[np.ndarray, "X Y Z"]:
        """Return the classes of a file; ids that do not count are empty. None: numbered as `write_prediction` does."""
        numbering = Numbering(cells_up=self.cells_up) if numbering is None else numbering
        table = class_table({number: number for number in (0, *self.ids) if number != UNKNOWN})
        classes = map_classes(read_array(path, "<u2", SHAPE), table if numbering.training_ids else self.table, path)
        return moved_up(np.where(classes == UNKNOWN, 0, classes).astype(np.uint8), numbering.cells_up)


def numbering_of(files: Sequence[tuple[CompletionScene, int, Path]]) -> Numbering:
    """Return how files of a submission, scene, frame and path of each, number classes and cells.

    The evaluation of SemanticKITTI takes the ids of the dataset's files (evaluate_completion.py). A submission may hold
    the numbers of training instead, most of which are no such ids. Of the cells of today's release and of the first
    one, one cell higher, those are taken whose occupied cells agree better with the labels. What is not decided by the
    values is read as the evaluation does.

    Raises:
        DataError: naming a damaged file.
    """
    known = {raw for scene, _, _ in files[:1] for raw in np.flatnonzero(scene.table >= 0).tolist()}
    numbers = {number for scene, _, _ in files[:1] for number in (0, *scene.ids)} - {UNKNOWN}
    found, agree = set[int](), {0: 0.0, 1: 0.0}
    for scene, frame, path in files:
        ids = read_array(path, "<u2", SHAPE)
        found |= set(np.unique(ids).tolist())
        labels = scene.own_voxels(frame, "none") if scene.cells_up else None
        if labels is not None:
            for up in agree:
                agree[up] += overlap(moved_up(ids, up) > 0, labels.numpy())
    first_release = any(scene.cells_up for scene, _, _ in files)
    return Numbering(not found <= known and found <= numbers, int(first_release and agree[1] >= agree[0]))


def overlap(occupied: np.ndarray, labels: UInt8[np.ndarray, "X Y Z"]) -> float:
    """Return the IoU of occupied cells among those whose class is known; 0 where none is occupied."""
    truth, known = (labels != 0) & (labels != UNKNOWN), labels != UNKNOWN
    return float((occupied & truth).sum() / max(((occupied | truth) & known).sum(), 1))


def moved_up(cells: np.ndarray, layers: int) -> np.ndarray:
    """Return cells some layers higher, below 0 lower; layers that come from outside are empty (0)."""
    moved = np.zeros_like(cells)
    depth = cells.shape[2]
    moved[..., max(layers, 0) : depth + min(layers, 0)] = cells[..., max(-layers, 0) : depth + min(-layers, 0)]
    return moved


def unknown_where(classes: UInt8[np.ndarray, "X Y Z"], cells: np.ndarray) -> UInt8[Tensor, "X Y Z"]:
    """Return classes that are unknown in these cells."""
    return torch.from_numpy(np.where(cells, np.uint8(UNKNOWN), classes))
