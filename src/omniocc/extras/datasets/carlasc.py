"""CarlaSC as a source: voxels, poses and LiDAR of CARLA's towns; it has no images."""

import re
from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from jaxtyping import UInt8
from torch import Tensor

from omniocc.camera import Equirectangular, Pinhole, Rig
from omniocc.classes import UNKNOWN, ClassTable, SemanticClass
from omniocc.data.formats.clouds import read_scan
from omniocc.data.formats.dataset_scene import Cloud, DatasetScene
from omniocc.data.formats.files import check_root, class_table, map_classes, read_array, read_text
from omniocc.data.formats.kitti import read_point_ids
from omniocc.data.formats.pose_table import read_matrices
from omniocc.data.labels.own_grid import OwnGridLabels
from omniocc.data.source import SPLITS, Benchmark, BenchmarkFrame, Ignore, SourceSpec, Split, refuse_unseen
from omniocc.data.source.own_grid import mirrored
from omniocc.data.store.shard import digest
from omniocc.errors import FAULTS, DataError
from omniocc.geometry import Cuboid, Cylinder, Grid
from omniocc.io import atomic_write, parse_json

ROAD_Z_M = -1.8
REMAP = (0, 1, 2, 3, 4, 5, 6, 6, 8, 9, 10, 2, 5, 3, 7, 3, 3, 2, 5, 3, 3, 3, 7)
"""Class of each of CARLA's 23 tags (UMich-CURLY/3DMapping, Data/dataset.py, LABELS_REMAP)."""
TABLE = class_table(dict(enumerate(REMAP)))
NAMES = (
    ("Free", (255, 255, 255)),
    ("Building", (70, 70, 70)),
    ("Barrier", (190, 153, 153)),
    ("Other", (55, 90, 80)),
    ("Pedestrian", (220, 20, 60)),
    ("Pole", (153, 153, 153)),
    ("Road", (128, 64, 128)),
    ("Ground", (81, 0, 81)),
    ("Sidewalk", (244, 35, 232)),
    ("Vegetation", (107, 142, 35)),
    ("Vehicle", (0, 0, 142)),
)
CLASSES = ClassTable(tuple(SemanticClass(number, name, rgb) for number, (name, rgb) in enumerate(NAMES)))
PREDICTED = class_table({row.id: row.id for row in CLASSES.rows})
"""Class of each id in files of predictions, which have our ids."""
SHAPE = (128, 128, 8)
GRIDS: dict[str, Cuboid | Cylinder] = {
    "cartesian": Cuboid(SHAPE, (-25.6, 25.6), (-25.6, 25.6), (-2.0, 1.0)),
    "cylindrical": Cylinder(SHAPE, (0.0, 30.0), (-2.0, 1.0)),
}
_EYE = Pinhole(8, 8, (4.0, 4.0), (3.5, 3.5))
BLIND = Rig((_EYE,), torch.eye(4, dtype=torch.float64)[None], ("none",), None, ROAD_Z_M)
"""The dataset has no camera; a batch needs one. Its images are black."""
FLIP = np.diag([1.0, -1.0, 1.0])
"""From Unreal's axes (y right) to ours (y left)."""


class CarlaSC:
    """A source (`SceneSource`) of CarlaSC, for sketches from true ranges and for scores; images are black.

    Args:
        root: folder with `Cartesian` or `Cylindrical`, each with Train, Val and Test.
        coordinates: cartesian or cylindrical: the grid of the labels.
        splits: names of the folders of train, val and test.
        panorama: width and height (px), upper and lower edge (deg) of the panoramas of ranges.
        cache: folder for class statistics; None: `omniocc` in root.

    Raises:
        ValueError: if an argument is impossible.
    """

    def __init__(
        self,
        root: str,
        coordinates: Literal["cartesian", "cylindrical"],
        splits: Mapping[Split, str],
        panorama: tuple[int, int, float, float],
        cache: str | None,
    ):
        if coordinates not in GRIDS or set(splits) != set(SPLITS):
            given = f"{coordinates} and {dict(splits)}"
            raise ValueError(f"coordinates must be of {', '.join(GRIDS)} and splits need {', '.join(SPLITS)}: {given}")
        self.root, self.coordinates, self.splits = root, coordinates, splits
        self.grid = GRIDS[coordinates]
        self.panorama = Equirectangular(*panorama)
        self.folder = Path(root, "omniocc") if cache is None else Path(cache)

    @property
    def spec(self) -> SourceSpec:
        """Return classes and bands; all cells count that a ray has met."""
        return SourceSpec(CLASSES, (0.0, 8.5, 17.0, 25.6), 0.1, ROAD_Z_M, None, Benchmark(self.grid))

    @property
    def fingerprint(self) -> str:
        """Return a hash of the scenes, their lengths and the panorama."""
        frames = [[split, scene.name, len(scene)] for split in SPLITS for scene in self.scenes(split)]
        return digest([frames, self.coordinates, repr(self.panorama)])

    def prepare(self) -> None:
        """Check the folders and that the grid in the files is the one expected.

        Raises:
            DataError: naming what is missing or wrong.
        """
        top = self.coordinates.capitalize()
        needed = [f"{top}/{self.splits[split]}" for split in SPLITS]
        check_root(self.root, needed, f"give the folder that holds CarlaSC's {top}")
        for split in SPLITS:
            for scene in self.scenes(split):
                scene.check()

    def scenes(self, split: Split) -> Sequence["CarlaSCScene"]:
        """Return the scenes of a split, in order of their names."""
        folder = Path(self.root, self.coordinates.capitalize(), self.splits[split])
        found = sorted(path for path in folder.iterdir() if (path / self.coordinates).is_dir())
        return [CarlaSCScene(path / self.coordinates, f"{split}-{path.name}", self) for path in found]

    def labels(self, geometry: Grid, ignore: Ignore) -> OwnGridLabels:
        """Return the voxels in a grid; if `ignore` is `unobserved`, those that no ray has met are unknown.

        Raises:
            ValueError: for `unseen`: there is no mask of what the cameras see.
        """
        refuse_unseen(ignore)
        return OwnGridLabels(self.folder, self.fingerprint, self.grid, geometry, CLASSES.num_classes, ignore)


class CarlaSCScene(DatasetScene):
    """One scene of 1,800 frames, 10 a second."""

    dataset = "CarlaSC"

    def __init__(self, folder: Path, name: str, source: CarlaSC):
        super().__init__(name, source.panorama)
        self.folder, self.grid = folder, source.grid

    def __len__(self) -> int:
        return len(self.numbers)

    @cached_property
    def numbers(self) -> list[int]:
        """Return the numbers of the frames."""
        names = (re.fullmatch(r"(\d{6})\.label", path.name) for path in (self.folder / "evaluation").glob("*.label"))
        return sorted(int(match[1]) for match in names if match)

    def check(self) -> None:
        """Raise DataError unless the files say that they hold the expected grid."""
        path = self.folder / "evaluation" / "params.json"
        try:
            params: dict[str, Any] = parse_json(read_text(path))
            shape = tuple(int(value) for value in params["grid_size"])
        except FAULTS as error:
            raise DataError(f"{path}: the file is damaged ({error!r})") from error
        if shape != SHAPE:
            raise DataError(f"{path}: grid_size is {shape} instead of {SHAPE}")

    @cached_property
    def world_from_ego(self) -> np.ndarray:
        """Return the pose of every frame; y is turned from right to left."""
        path = self.folder / "poses.txt"
        _, theirs = read_matrices(path)
        if self.numbers and self.numbers[-1] >= len(theirs):
            raise DataError(f"{path}: it has {len(theirs)} poses, but there are voxels of frame {self.numbers[-1]}")
        poses = theirs[self.numbers].copy()
        poses[:, :3, :3] = FLIP @ poses[:, :3, :3] @ FLIP
        poses[:, :3, 3] = poses[:, :3, 3] @ FLIP
        return poses

    @property
    def rigs(self) -> tuple[Rig, ...]:
        """Return the stand-in for a camera."""
        return (BLIND,) * len(self)

    def images(self, frame: int) -> list[np.ndarray]:
        """Return a black image: there are none."""
        del frame
        return [np.zeros((8, 8, 3), np.uint8)]

    def cloud(self, frame: int) -> Cloud | None:
        """Return the points of the LiDAR with their classes."""
        if not (self.folder / "velodyne").is_dir():
            return None
        number = self.numbers[frame]
        with self.naming(frame):
            points, kept = read_scan(self.folder / "velodyne" / f"{number:06d}.bin", 4)
            path = self.folder / "labels" / f"{number:06d}.label"
            classes = map_classes(read_point_ids(path, kept), TABLE, path)
        labels = np.where(classes == 0, UNKNOWN, classes).astype(np.uint8)
        return Cloud(points @ FLIP.astype(np.float32), labels, np.zeros(3))

    def camera_range_m(self, frame: int) -> None:
        """Return None: there are no cameras."""

    def pixel_labels(self, frame: int) -> None:
        """Return None: there are no cameras."""

    def own_voxels(self, frame: int, ignore: Ignore) -> UInt8[Tensor, "X Y Z"]:
        """Return the class of every cell; those that no ray has met are unknown unless `ignore` is `none`."""
        labels, seen = self._voxels(frame)
        return torch.from_numpy(np.where(seen | (ignore == "none"), labels, UNKNOWN).astype(np.uint8))

    def benchmark(self, frame: int) -> BenchmarkFrame:
        """Return the voxels, of which only those count that a ray has met."""
        labels, seen = self._voxels(frame)
        return BenchmarkFrame(torch.from_numpy(labels), torch.from_numpy(seen))

    def prediction_file(self, frame: int) -> str:
        """Return the place of a frame's file in a folder of predictions."""
        return f"{self.name}/{self.numbers[frame]:06d}.label"

    def write_prediction(self, path: Path, classes: UInt8[np.ndarray, "X Y Z"]) -> None:
        """Write classes as 32 bits in the axes of the files."""
        atomic_write(path, mirrored(classes).astype("<u4").tobytes())

    def read_prediction(self, path: Path) -> UInt8[np.ndarray, "X Y Z"]:
        """Return the classes of a file that `write_prediction` wrote."""
        return mirrored(map_classes(read_array(path, "<u4", SHAPE), PREDICTED, path))

    def _voxels(self, frame: int) -> tuple[np.ndarray, np.ndarray]:
        stem = self.folder / "evaluation" / f"{self.numbers[frame]:06d}"
        with self.naming(frame):
            path = stem.with_suffix(".label")
            labels = map_classes(read_array(path, "<u4", SHAPE), TABLE, path)
            seen = read_array(stem.with_suffix(".bin"), "<f4", SHAPE) > 0
        return mirrored(labels), mirrored(seen)
