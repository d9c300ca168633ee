"""Protocols of sources of scenes and of their labels, and the facts that every source states."""

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, NamedTuple, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float64, Int64, UInt8
from torch import Tensor

from omniocc.camera import Rig
from omniocc.classes import ClassTable
from omniocc.errors import UserError
from omniocc.geometry import Grid
from rayiou.directions import RayOrigins

Split = Literal["train", "val", "test"]
SPLITS: tuple[Split, ...] = ("train", "val", "test")

Ignore = Literal["none", "unobserved", "unseen"]
"""Which cells losses and scores ignore (255). `none`: no cell; cells without points are free, as in the paper.
`unobserved`: cells without points that no ray of a sensor crossed. `unseen`: all cells that no camera sees, if the
dataset has a mask of these."""


def refuse_unseen(ignore: Ignore, remedy: str = "choose none or unobserved") -> None:
    """Raise UserError if `ignore` is `unseen`; for datasets without a mask of the cells that cameras see."""
    if ignore == "unseen":
        raise UserError(f"data.ignore=unseen: there is no mask of what cameras see; {remedy}")


@dataclass(frozen=True)
class Benchmark:
    """How a dataset's own protocol scores predictions: on its own voxels, whatever the grid of the model.

    Attributes:
        grid: grid of the dataset's labels, in the ego frame.
        masked_rays: whether cells that do not count are unknown in the scores of rays too; False: rays see all cells,
            and the mask is for the scores of cells alone.
        parts: smaller parts of the grid whose cells are also scored apart: a name, and the ends along x and y, m.
    """

    grid: Grid
    masked_rays: bool = True
    parts: tuple[tuple[str, tuple[float, float], tuple[float, float]], ...] = ()


@dataclass(frozen=True, eq=False)
class SourceSpec:
    """Facts about all scenes of a source.

    Attributes:
        classes: classes of voxels, pixels and LiDAR hits.
        range_edges_m: ends of the distance bands in which scores are given. LiDAR hits at the last of them or beyond
            count as free for every grid.
        frame_interval_s: time between recorded frames, s.
        road_z_m: height of the road in the ego frame, m; None: it differs from scene to scene, see `road_of`.
        lidar_directions: unit rays of the LiDAR, which starts in the ego origin. None: every frame has its own rays,
            or there is no LiDAR.
        benchmark: the dataset's own protocol. None: scores are computed on the grid of the model.
        ray_directions: unit rays of voxel RayIoU; None: the public 39 x 360.
    """

    classes: ClassTable
    range_edges_m: tuple[float, ...]
    frame_interval_s: float
    road_z_m: float | None
    lidar_directions: Float64[Tensor, "R 3"] | None
    benchmark: Benchmark | None = None
    ray_directions: Float64[Tensor, "D 3"] | None = None

    def __post_init__(self) -> None:
        """Check the bands; raise ValueError if there are none or their edges do not increase."""
        edges = self.range_edges_m
        if len(edges) < 2 or any(low >= high for low, high in itertools.pairwise(edges)):
            raise ValueError(f"range_edges_m must be two or more increasing distances, got {edges}")

    @property
    def reach_m(self) -> float:
        """Return the horizontal distance beyond which LiDAR hits count as free, m."""
        return self.range_edges_m[-1]

    def road_of(self, rig: Rig) -> float | None:
        """Return the height of the road in the ego frame of a scene with these cameras, m; None if it is not known."""
        return self.road_z_m if rig.road_z_m is None else rig.road_z_m

    def scored_grid(self, geometry: Grid) -> Grid:
        """Return the grid on which a model's predictions are scored: the benchmark's, else the model's `geometry`."""
        return geometry if self.benchmark is None else self.benchmark.grid


class BenchmarkFrame(NamedTuple):
    """The truth of one frame on the grid of its `Benchmark`.

    Attributes:
        voxels: class of every cell, 255 unknown.
        scored: cells that count in scores; None: all whose class is known.
        ray_origins: where RayIoU's rays start, float32; None: in the ego origin.
    """

    voxels: UInt8[Tensor, "X Y Z"]
    scored: Bool[Tensor, "X Y Z"] | None = None
    ray_origins: RayOrigins | None = None


class LidarScan(NamedTuple):
    """The hits of a LiDAR in one frame.

    Attributes:
        range_m: (R,) float32 range along every ray, m; inf where nothing is hit.
        labels: (R,) uint8 class that is hit; 0 where nothing is hit, 255 unknown.
        directions: (R, 3) float32 unit rays in the ego frame.
        origins: (R, 3) float32 where the rays start, m, ego frame; None: in the ego origin.
        moving: (R,) bool whether what is hit moves; None if the dataset does not tell.
    """

    range_m: np.ndarray
    labels: np.ndarray
    directions: np.ndarray
    origins: np.ndarray | None = None
    moving: np.ndarray | None = None


class Points(NamedTuple):
    """Labelled surface points of a frame.

    Attributes:
        points_m: (P, 3) float32, m, ego frame.
        labels: (P,) uint8 class of each, 255 unknown; never 0.
    """

    points_m: np.ndarray
    labels: np.ndarray


@runtime_checkable
class SceneFrames(Protocol):
    """The frames of one scene, decoded; picklable. Methods return None where the dataset has no such data.

    Frames have numbers from 0 in the order of time. Errors in reading are `omniocc.errors.DataError`.
    """

    @property
    def name(self) -> str:
        """Return the scene's name, unique in its source."""
        ...

    @property
    def world_from_ego(self) -> np.ndarray:
        """Return the pose of every frame, (F, 4, 4) float64."""
        ...

    @property
    def rigs(self) -> Sequence[Rig]:
        """Return the rig of every frame: in data of real cars the poses of cameras differ from frame to frame."""
        ...

    def __len__(self) -> int:
        """Return the number of frames."""
        ...

    def images(self, frame: int) -> list[np.ndarray]:
        """Return the image of every camera, (H, W, 3) uint8 RGB each."""
        ...

    def pixel_labels(self, frame: int) -> list[np.ndarray] | None:
        """Return the classes of the pixels of every camera, (H, W) uint8 each; 0 sky, 255 unknown."""
        ...

    def camera_range_m(self, frame: int) -> list[np.ndarray] | None:
        """Return the true range of the pixels of every camera, (H, W) float32 each, m; inf sky, nan unknown."""
        ...

    def erp_range_m(self, frame: int) -> np.ndarray | None:
        """Return the true panorama of range around the ego origin, (h, w) float32, m; inf sky, nan unknown."""
        ...

    def lidar(self, frame: int) -> LidarScan | None:
        """Return the hits of the LiDAR; None where they have no classes, which a further method `scan` may return."""
        ...

    def points(self, frame: int) -> Points | None:
        """Return the labelled points that vote for voxels."""
        ...


def has_poses(scene: SceneFrames) -> bool:
    """Return whether the poses of a scene are known; an attribute `has_poses` says so where they are not."""
    return getattr(scene, "has_poses", True)


@runtime_checkable
class SubmittedScene(SceneFrames, Protocol):
    """A scene of a dataset whose benchmark takes predictions as files, one for each frame, on its own grid."""

    def prediction_file(self, frame: int) -> str:
        """Return the file of a frame's prediction, relative to the folder of a submission."""
        ...

    def write_prediction(self, path: Path, classes: UInt8[np.ndarray, "X Y Z"]) -> None:
        """Write our classes (0 free) of one frame in the benchmark's format; raise DataError if the disk refuses."""
        ...

    def read_prediction(self, path: Path) -> UInt8[np.ndarray, "X Y Z"]:
        """Return our classes (0 free) of a file in the benchmark's format; raise DataError naming what is wrong."""
        ...


PredictionReader = Callable[[SubmittedScene, Path], UInt8[np.ndarray, "X Y Z"]]
"""A function that returns our classes (0 free) of a scene's file in the benchmark's format."""


@runtime_checkable
class NumberedSubmissions(Protocol):
    """A source whose submissions number classes or cells in one of several ways; the values in them tell which."""

    def prediction_reader(self, files: Sequence[tuple[SubmittedScene, int, Path]]) -> tuple[PredictionReader, str]:
        """Return the function that reads these files (scene, frame, path), and a line on how they are numbered."""
        ...


@runtime_checkable
class VoxelLabels(Protocol):
    """The voxel labels of a source in one grid."""

    def prepare(self, scenes: Sequence[SceneFrames]) -> None:
        """Make the missing labels of these scenes; safe to call from several processes at once."""
        ...

    def read(self, scene: SceneFrames, frame: int) -> UInt8[Tensor, "X Y Z"] | None:
        """Return the class of every cell, 255 unknown; None without labels."""
        ...

    def benchmark(self, scene: SceneFrames, frame: int) -> BenchmarkFrame | None:
        """Return the truth on the grid of the source's `Benchmark`; None if it has none, or the frame no labels."""
        ...

    def counts(self, scenes: Sequence[SceneFrames]) -> Int64[Tensor, "C X Y Z"]:
        """Return the number of frames in which each cell has each class; unknown is not counted."""
        ...


@runtime_checkable
class SceneSource(Protocol):
    """A dataset: its scenes, and the meaning of their labels."""

    @property
    def spec(self) -> SourceSpec:
        """Return the facts about all scenes.

        Raises:
            DataError: when it has to be read from scenes and there are none.
        """
        ...

    @property
    def fingerprint(self) -> str:
        """Return a hash that is equal for equal data."""
        ...

    @property
    def folder(self) -> Path:
        """Return the local folder of data derived from the scenes."""
        ...

    def prepare(self) -> None:
        """Make or find all scenes; safe to call from several processes at once and to repeat after a kill.

        Raises:
            DataError: when scenes are missing and cannot be made.
        """
        ...

    def scenes(self, split: Split) -> Sequence[SceneFrames]:
        """Return the scenes of a split, in order, after `prepare`; raise DataError when one is missing."""
        ...

    def labels(self, geometry: Grid, ignore: Ignore) -> VoxelLabels:
        """Return the voxel labels of a grid.

        Raises:
            ValueError: if the source has no labels of this grid, or of this kind.
        """
        ...


@runtime_checkable
class MadeScenes(Protocol):
    """The further methods of a source that renders its scenes on demand and knows their cameras and lengths before.

    It does not inherit `SceneSource`: before Python 3.12 `isinstance` reads every property of a protocol, and the
    properties of `SceneSource` read files that `prepare` has yet to make.
    """

    @property
    def made_here(self) -> bool:
        """Return whether scenes that are missing are made on this machine, rather than read from elsewhere."""
        ...

    def planned_rig(self) -> Rig:
        """Return the cameras of the first training scene."""
        ...

    def planned(self, split: Split) -> dict[str, int]:
        """Return the number of frames of each scene of a split, by name, in order."""
        ...

    def missing(self) -> Sequence[object]:
        """Return the plans of the scenes that are not there yet."""
        ...

    def made(self, split: Split, names: Sequence[str]) -> list[SceneFrames]:
        """Return the scenes of a split with these names; make those that are missing first."""
        ...
