"""ParkOcc as a source: four real fisheyes of a car in car parks, voxels as sparse rows. One scene is public.

Format: tools/create_own_data.py and projects/mmdet3d_plugin/datasets of https://github.com/yty-sky/ParkOcc. No real
file of it has been read here.
"""

import warnings
from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float64, UInt8
from torch import Tensor

from omniocc.camera import OCam, Rig
from omniocc.camera.pose import LEVEL_FORWARD
from omniocc.classes import ClassTable, SemanticClass
from omniocc.data.formats.clouds import read_scan
from omniocc.data.formats.dataset_scene import Cloud
from omniocc.data.formats.files import (
    check_root,
    class_table,
    map_classes,
    read_image,
    read_npy,
    read_text,
    scaled_size,
)
from omniocc.data.formats.poses import inverse, rigid
from omniocc.data.source import Benchmark, Ignore, SourceSpec, Split
from omniocc.data.source.own_grid import OwnGridScene, OwnGridSource
from omniocc.errors import FAULTS, DataError
from omniocc.extras.datasets.ocam import read_ocam
from omniocc.geometry import Cuboid
from omniocc.io import number_of, parse_yaml, twice

CAMERAS = ("front", "left", "right", "back")
SIZE = (1920, 1080)
"""Width and height of the images, px."""
LENS_DEG = 95.0
"""Angle off the optical axis up to which images are used: not stated by the dataset, whose code stops at 90."""
SHAPE = (200, 200, 32)
GRID = Cuboid(SHAPE, (-10.0, 10.0), (-10.0, 10.0), (-2.6, 0.6))
"""The voxels in the frame of the LiDAR: x forward, y left, z up; cells of .1 m."""
NAMES = (
    ("free", (255, 255, 255)),
    ("car", (0, 0, 142)),
    ("wall", (156, 102, 102)),
    ("road", (128, 64, 128)),
    ("park", (250, 170, 160)),
    ("person", (220, 20, 60)),
)
CLASSES = ClassTable(tuple(SemanticClass(number, name, rgb) for number, (name, rgb) in enumerate(NAMES)))
"""The ids of the files; cells that no row names are free."""
TABLE = class_table({row.id: row.id for row in CLASSES.rows})
INTERVAL_S = 0.1
"""Time between frames: not stated by the dataset."""


class ParkOcc(OwnGridSource["ParkOccScene"]):
    """A source (`SceneSource`) of ParkOcc; the ego frame is that of the LiDAR.

    Args:
        root: folder with `calib`, `sequences` and, for ranges, `velodyne`: the dataset's `data_train`.
        sequences: folders of the scenes of train, val and test. One scene is public, so there is no split: where a
            scene of train is in val or test too, a warning says what the scores are worth.
        image_width: see `OwnGridSource`.
        panorama: see `OwnGridSource`.
        road_z_m: height of the road in the frame of the LiDAR, m.
        cache: see `OwnGridSource`.

    Raises:
        ValueError: if a split or the width is impossible.
    """

    classes = CLASSES

    def __init__(
        self,
        root: str,
        sequences: Mapping[Split, Sequence[str]],
        image_width: int,
        panorama: tuple[int, int, float, float],
        road_z_m: float,
        cache: str | None,
    ):
        super().__init__(root, sequences, image_width, panorama, cache)
        self.road_z_m = road_z_m

    @property
    def grid(self) -> Cuboid:
        """Return the voxels of the labels."""
        return GRID

    @property
    def spec(self) -> SourceSpec:
        """Return classes, bands and the protocol: all voxels count, there is no mask."""
        return SourceSpec(CLASSES, (0.0, 2.5, 5.0, 10.0), INTERVAL_S, self.road_z_m, None, Benchmark(GRID))

    def prepare(self) -> None:
        """Check the folders; warn if the network is tested on scenes that it is trained on.

        Raises:
            DataError: naming what is missing or wrong.
        """
        check_root(self.root, ["calib", "sequences"], "give the folder 'data_train' of ParkOcc")
        names = list(self.all_scenes)
        check_root(str(Path(self.root, "sequences")), names, "name the folders there in data.source.sequences", "")
        for scene in self.all_scenes.values():
            if not len(scene):
                raise DataError(f"{scene.folder}: no folder of a frame with a pose is in it; unpack the scene again")
        seen = set(self.sequences["train"]) & {*self.sequences["val"], *self.sequences["test"]}
        if seen:
            warnings.warn(
                f"ParkOcc: scene {', '.join(sorted(seen))} is for training and for scores, which say nothing of other "
                "places then. One scene is public, so no split exists",
                stacklevel=2,
            )

    def sequence(self, name: str) -> "ParkOccScene":
        """Return a scene by its folder."""
        return ParkOccScene(name, self)

    @cached_property
    def rig(self) -> Rig:
        """Return the cameras, the same in every scene."""
        cameras, poses = [], []
        for name in CAMERAS:
            camera, lidar_from_camera = read_camera(Path(self.root, "calib", name), name)
            cameras.append(camera.resized(*scaled_size(*SIZE, self.image_width)))
            poses.append(lidar_from_camera)
        return Rig(tuple(cameras), torch.from_numpy(np.stack(poses)), CAMERAS, None, self.road_z_m)


class ParkOccScene(OwnGridScene):
    """The frames of one scene that have a folder and a pose."""

    dataset = "ParkOcc"

    def __init__(self, name: str, source: ParkOcc):
        super().__init__(name, source.panorama)
        self.folder = Path(source.root, "sequences", name)
        self.scans = Path(source.root, "velodyne", name)
        self.source = source

    @property
    def rig(self) -> Rig:
        """Return the cameras, the same in every frame."""
        return self.source.rig

    @cached_property
    def numbers(self) -> list[str]:
        """Return the names of the frames' folders, in the order of their numbers."""
        found = [path.name for path in self.folder.iterdir() if path.name.isascii() and path.name.isdigit()]
        return sorted((name for name in found if int(name) in self.poses), key=int)

    @cached_property
    def poses(self) -> dict[int, Float64[np.ndarray, "4 4"]]:
        """Return the pose of the LiDAR in every frame that has one, by number."""
        path = self.folder.parent / f"dataset_sence_{self.name}.yaml"  # so in the dataset
        try:
            content: Any = parse_yaml(read_text(path, "unpack the scene's poses beside its folder"))
            if (number := twice(int(key) for key in content)) is not None:
                raise ValueError(f"frame {number} stands twice")
            return {int(key): rigid(as_pose(entry["matrix"]), f"frame {key}") for key, entry in content.items()}
        except FAULTS as error:
            reason = f"a frame has no '{error.args[0]}'" if isinstance(error, KeyError) else str(error)
            raise DataError(f"{path}: {reason}; poses are frames by number, each with a 4x4 'matrix'") from error

    @cached_property
    def world_from_ego(self) -> np.ndarray:
        """Return the pose of every frame."""
        return np.stack([self.poses[int(name)] for name in self.numbers])

    def images(self, frame: int) -> list[np.ndarray]:
        """Return the images, scaled."""
        name = self.numbers[frame]
        with self.naming(frame):
            return [
                read_image(self.folder / name / f"{view}_{name}.jpg", SIZE, (camera.width, camera.height))
                for view, camera in zip(CAMERAS, self.rig.cameras, strict=True)
            ]

    def cloud(self, frame: int) -> Cloud | None:
        """Return the points of the LiDAR, whose classes are not known; None where the scene has no scans."""
        if not self.scans.is_dir():
            return None
        name = self.numbers[frame]
        with self.naming(frame):
            points, _ = read_scan(self.scans / name / f"pc_{name}.bin", 4)
        return Cloud(points, None, np.zeros(3))

    def own_voxels(self, frame: int, ignore: Ignore) -> UInt8[Tensor, "200 200 32"]:
        """Return the class of every cell. There is no mask, so `ignore` changes nothing."""
        del ignore
        name = self.numbers[frame]
        with self.naming(frame):
            return torch.from_numpy(dense_voxels(self.folder / name / f"occ_{name}.npy"))


def dense_voxels(path: Path) -> UInt8[np.ndarray, "200 200 32"]:
    """Return the class of every cell of a file with rows of x, y, z (places of cells) and class; other cells are free.

    Raises:
        DataError: naming the file and the first row that is impossible.
    """
    rows = read_npy(path, (-1, 4))
    cells, classes = rows[:, :3], map_classes(rows[:, 3], TABLE, path)
    wrong = np.flatnonzero(((cells < 0) | (cells >= SHAPE)).any(axis=1))
    if len(wrong):
        raise DataError(f"{path}: row {wrong[0]} is {rows[wrong[0]].tolist()}, but the grid has {SHAPE} cells")
    voxels = np.zeros(SHAPE, np.uint8)
    voxels[tuple(cells.T)] = classes
    return voxels


def read_camera(folder: Path, name: str) -> tuple[OCam, Float64[np.ndarray, "4 4"]]:
    """Return a fisheye at the size of its files, and its pose lidar_from_camera.

    The matrix in the file takes points from the LiDAR to axes of the camera that are x forward, y left, z up
    (`image_utils.py` turns them into OCamCalib's).

    Raises:
        DataError: naming the file and what is wrong.
    """
    lens, place = folder / f"calib_results_{name}.txt", folder / f"results_{name}.csv"
    camera = read_ocam(lens, SIZE, LENS_DEG)
    try:
        rows = [line.split(",") for line in read_text(place).splitlines() if line.strip()]
        camera_from_lidar = rigid(as_pose(rows), "the matrix")
    except ValueError as error:
        raise DataError(f"{place}: {error}") from error
    turn = np.eye(4)
    turn[:3, :3] = LEVEL_FORWARD
    return camera, inverse(camera_from_lidar) @ turn


def as_pose(values: Any) -> Float64[np.ndarray, "4 4"]:
    """Return 16 numbers, nested or not, as a matrix; raise ValueError if there are others."""
    numbers = [number_of(str(value)) for value in np.asarray(values, object).ravel()]
    if len(numbers) != 16:
        raise ValueError(f"a pose has {len(numbers)} numbers instead of 16")
    return np.reshape(numbers, (4, 4))
