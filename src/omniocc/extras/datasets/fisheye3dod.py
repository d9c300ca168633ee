"""Fisheye3DOD as a source: four fisheyes and six pinholes on one car in CARLA; voxels voted by its semantic LiDAR.

Format: utils/fisheye3dod_calib.py and dataset/loading.py of https://github.com/weiyangdaren/Fisheye3DOD. No real file
of it has been read here, and no code of the authors reads the semantic LiDAR.
"""

import re
from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from jaxtyping import Float32, Float64, UInt8

from omniocc.camera import Camera, Equirectangular, Pinhole, Rig
from omniocc.classes import UNKNOWN, WORLD_CLASSES
from omniocc.data.formats.clouds import came_back, read_rows
from omniocc.data.formats.dataset_scene import Cloud, DatasetScene, outside
from omniocc.data.formats.files import check_root, read_image, read_text, scaled_size
from omniocc.data.formats.poses import inverse, transform_points
from omniocc.data.labels.own_grid import VotedLabels
from omniocc.data.source import SPLITS, Ignore, Points, SourceSpec, Split, refuse_unseen
from omniocc.data.store.shard import digest
from omniocc.errors import DataError
from omniocc.extras.carla_tags import class_table, tags_of
from omniocc.extras.datasets.ocam import read_ocam
from omniocc.extras.unreal import SENSOR_FROM_OPTICAL, UnrealPose, pose_of, right_handed_points
from omniocc.geometry import Grid
from omniocc.io import number_of

LIDAR = "semantic_lidar"
VIEWS = {
    "fisheye": ("fisheye_camera_front", "fisheye_camera_left", "fisheye_camera_right", "fisheye_camera_rear"),
    "pinhole": (
        "nu_rgb_camera_front",
        "nu_rgb_camera_front_left",
        "nu_rgb_camera_front_right",
        "nu_rgb_camera_rear",
        "nu_rgb_camera_rear_left",
        "nu_rgb_camera_rear_right",
    ),
}
SIZES = {"fisheye": (800, 800), "pinhole": (1280, 720)}
"""Width and height of the images, px."""
CALIBRATION = "calib_results.txt"
LENS_DEG = 110.0
"""Angle off the axis at which the fisheyes end; the pinholes see 90 degrees from left to right."""
OWN_CAR_M = ((-3.0, -1.2, -3.0), (3.0, 1.2, 0.3))
"""Lowest and highest x, y, z of the own car, frame of the LiDAR; points in it are left out. The dataset is silent."""
MOVING = tuple(WORLD_CLASSES.names.index(name) for name in ("Vehicle", "Pedestrian"))
"""Classes that vote for the voxels of their own frame alone."""
FRAMES_PER_S = 10.0
METADATA = "sensor_metadata.txt"
NUMBER = r"([-+.\deE]+)"
TRANSFORM = re.compile(
    rf"frame=(\d+),.*?Transform\(Location\(x={NUMBER},\s*y={NUMBER},\s*z={NUMBER}\),\s*"
    rf"Rotation\(pitch={NUMBER},\s*yaw={NUMBER},\s*roll={NUMBER}\)\)"
)


class Fisheye3DOD:
    """A source (`SceneSource`) of Fisheye3DOD; the ego frame is that of the semantic LiDAR.

    Args:
        root: folder with the recordings and `calib_results.txt`.
        towns: names of the towns of train, val and test. The dataset's own lists share all recordings.
        views: fisheye (four) or pinhole (six, as nuScenes has them).
        frame_step: every how many-th frame is taken; 10 are recorded a second.
        accumulate: frames of the files before and after each whose points vote for its voxels too, but for vehicles
            and pedestrians.
        carla_version: of the server that recorded, by which tags have their meaning.
        y: direction of the second axis of the points in the files, left or right.
        image_width: of the images that the model gets, px; the height follows, a multiple of 8.
        panorama: width and height (px), upper and lower edge (deg) of the panoramas of ranges.
        road_z_m: height of the road below the LiDAR, m.
        cache: folder for class statistics; None: `omniocc` in root.

    Raises:
        ValueError: naming the argument that is impossible.
        UserError: if the version is none.
    """

    def __init__(
        self,
        root: str,
        towns: Mapping[Split, Sequence[str]],
        views: Literal["fisheye", "pinhole"],
        frame_step: int,
        accumulate: int,
        carla_version: str,
        y: Literal["left", "right"],
        image_width: int,
        panorama: tuple[int, int, float, float],
        road_z_m: float,
        cache: str | None,
    ):
        if image_width < 8 or frame_step < 1 or accumulate < 0:
            given = f"{image_width}, {frame_step} and {accumulate}"
            raise ValueError(f"image_width must be at least 8, frame_step 1 and accumulate 0, got {given}")
        if views not in VIEWS or y not in ("left", "right"):
            raise ValueError(f"views must be of {', '.join(VIEWS)} and y left or right, got {views} and {y}")
        self.towns = {split: list(towns.get(split, ())) for split in SPLITS}
        every = [town for split in SPLITS for town in self.towns[split]]
        if set(towns) != set(SPLITS) or len(set(every)) < len(every):
            raise ValueError(f"towns need {', '.join(SPLITS)}, every town in one of them, got {dict(towns)}")
        self.root, self.views, self.y = root, views, y
        self.frame_step, self.accumulate, self.image_width = frame_step, accumulate, image_width
        table = class_table(tags_of(carla_version))
        self.table = np.where(table == 0, UNKNOWN, table).astype(np.uint8)  # a hit is not free
        self.panorama, self.road_z_m = Equirectangular(*panorama), road_z_m
        self.folder = Path(root, "omniocc") if cache is None else Path(cache)

    @property
    def spec(self) -> SourceSpec:
        """Return the classes of the virtual world; there is no grid of the dataset's own."""
        interval_s = self.frame_step / FRAMES_PER_S
        return SourceSpec(WORLD_CLASSES, (0.0, 8.5, 17.0, 25.6), interval_s, self.road_z_m, None)

    @property
    def fingerprint(self) -> str:
        """Return a hash of the frames and of the options that labels and images depend on."""
        frames = [[split, scene.name, scene.numbers] for split in SPLITS for scene in self.scenes(split)]
        options = [self.views, self.accumulate, self.table.tolist(), self.y, self.image_width, repr(self.panorama)]
        return digest([frames, options, self.road_z_m])

    def prepare(self) -> None:
        """Check the folders.

        Raises:
            DataError: naming what is missing or wrong.
        """
        check_root(self.root, [CALIBRATION] if self.views == "fisheye" else [], "give Fisheye3DOD's own folder")
        found = sorted(self.recordings)
        for town in (town for split in SPLITS for town in self.towns[split]):
            if town not in self.recordings:
                known = ", ".join(found) or "none"
                raise DataError(f"{self.root}: no recording of {town} is there, only of {known}; set data.source.towns")
        for scene in (scene for split in SPLITS for scene in self.scenes(split)):
            check_root(str(scene.folder), [LIDAR, *VIEWS[self.views]], "unpack the whole recording", "")
            if not len(scene):
                raise DataError(f"{scene.folder / LIDAR}: there are no files such as 00026981.bin; unpack it again")

    @cached_property
    def recordings(self) -> dict[str, list[Path]]:
        """Return the folders of the recordings of every town, in order."""
        by_town: dict[str, list[Path]] = {}
        for path in sorted(Path(self.root).glob("*-Town*/ego0")):
            by_town.setdefault(town_of(path.parent.name), []).append(path)
        return by_town

    def scenes(self, split: Split) -> Sequence["Fisheye3DODScene"]:
        """Return the recordings of the towns of a split."""
        return [Fisheye3DODScene(path, self) for town in self.towns[split] for path in self.recordings.get(town, [])]

    def labels(self, geometry: Grid, ignore: Ignore) -> VotedLabels:
        """Return voxels voted by the accumulated points when they are asked for.

        Raises:
            ValueError: for `unseen`: there is no mask of what the cameras see.
        """
        refuse_unseen(ignore)
        return VotedLabels(self.folder, self.fingerprint, geometry, WORLD_CLASSES.num_classes, ignore)

    @cached_property
    def camera(self) -> Camera:
        """Return the camera that all views have, at the size of the images that the model gets."""
        width, height = SIZES[self.views]
        if self.views == "pinhole":
            camera: Camera = Pinhole(width, height, (width / 2, width / 2), ((width - 1) / 2, (height - 1) / 2))
        else:
            camera = read_ocam(Path(self.root, CALIBRATION), (width, height), LENS_DEG)
        return camera.resized(*scaled_size(width, height, self.image_width))


class Fisheye3DODScene(DatasetScene):
    """Every `frame_step`-th frame of one recording."""

    dataset = "Fisheye3DOD"

    def __init__(self, folder: Path, source: Fisheye3DOD):
        super().__init__(folder.parent.name, source.panorama)
        self.folder, self.source = folder, source

    def __len__(self) -> int:
        return len(self.numbers)

    @cached_property
    def files(self) -> list[int]:
        """Return the numbers of all files of the LiDAR, in order."""
        names = (path.stem for path in (self.folder / LIDAR).glob("*.bin"))
        return sorted(int(name) for name in names if name.isascii() and name.isdigit())

    @cached_property
    def numbers(self) -> list[int]:
        """Return the numbers of the frames that are taken."""
        return [number for number in self.files if (number - self.files[0]) % self.source.frame_step == 0]

    @cached_property
    def lidar_poses(self) -> dict[int, Float64[np.ndarray, "4 4"]]:
        """Return world_from_lidar of every frame, by number."""
        return read_poses(self.folder / LIDAR)

    @cached_property
    def world_from_ego(self) -> np.ndarray:
        """Return the pose of every frame."""
        return np.stack([self._pose(number) for number in self.numbers])

    @cached_property
    def rigs(self) -> tuple[Rig, ...]:
        """Return the cameras, which stay where they are in the first frame."""
        first, source = self.numbers[0], self.source
        poses = []
        for name in VIEWS[source.views]:
            found = read_poses(self.folder / name)
            if first not in found:
                raise DataError(f"{self.folder / name / METADATA}: it has no pose of frame {first}")
            poses.append(inverse(self._pose(first)) @ found[first] @ SENSOR_FROM_OPTICAL)
        cameras = (source.camera,) * len(poses)
        rig = Rig(cameras, torch.from_numpy(np.stack(poses)), VIEWS[source.views], None, source.road_z_m)
        return (rig,) * len(self)

    def images(self, frame: int) -> list[np.ndarray]:
        """Return the images, scaled."""
        size, camera = SIZES[self.source.views], self.source.camera
        with self.naming(frame):
            return [
                read_image(self.folder / name / f"{self.numbers[frame]:08d}.png", size, (camera.width, camera.height))
                for name in VIEWS[self.source.views]
            ]

    def cloud(self, frame: int) -> Cloud:
        """Return the points of the semantic LiDAR with their classes."""
        with self.naming(frame):
            return Cloud(*self._scan(self.numbers[frame]), np.zeros(3))

    def points(self, frame: int) -> Points:
        """Return the points of this scan, and those of its neighbours that stand, in the ego frame of this one."""
        number = self.numbers[frame]
        place, reach = self.files.index(number), self.source.accumulate
        points, labels = [], []
        with self.naming(frame):
            for other in self.files[max(0, place - reach) : place + reach + 1]:
                points_m, classes = self._scan(other)
                kept = np.ones(len(classes), bool) if other == number else ~np.isin(classes, MOVING)
                here = inverse(self._pose(number)) @ self._pose(other)
                points.append(transform_points(here, points_m[kept]).astype(np.float32))
                labels.append(classes[kept])
        return Points(np.concatenate(points), np.concatenate(labels))

    def _pose(self, number: int) -> Float64[np.ndarray, "4 4"]:
        if number not in self.lidar_poses:
            raise DataError(f"{self.folder / LIDAR / METADATA}: it has no pose of frame {number}")
        return self.lidar_poses[number]

    def _scan(self, number: int) -> tuple[Float32[np.ndarray, "P 3"], UInt8[np.ndarray, " P"]]:
        """Return the points around the own car in the frame of the LiDAR, and their classes, of a frame's file."""
        points_m, tags = read_points(self.folder / LIDAR / f"{number:08d}.bin")
        if self.source.y == "right":
            points_m = right_handed_points(points_m)
        kept = outside(points_m, *OWN_CAR_M)
        return points_m[kept], self.source.table[tags[kept]]


def town_of(recording: str) -> str:
    """Return the town in the name of a recording: 'Town01' of 'train-Town01_Opt-ClearNoon-2024_09_23_11_44_45'."""
    return recording.split("-")[1].removesuffix("_Opt")


def read_poses(folder: Path) -> dict[int, Float64[np.ndarray, "4 4"]]:
    """Return world_from_sensor of every frame in a sensor's `sensor_metadata.txt`, by number.

    All frames have x forward, y left, z up: they are the mirror images of CARLA's, whose y points right. (The dataset's
    own code turns pitch and roll the other way, which shows where a car does not stand level.)

    Raises:
        DataError: if the file is missing or has no pose.
    """
    path = folder / METADATA
    poses: dict[int, Float64[np.ndarray, "4 4"]] = {}
    for frame, *values in TRANSFORM.findall(read_text(path, "unpack the whole recording")):
        if int(frame) in poses:
            raise DataError(f"{path}: frame {frame} stands twice; keep one")
        try:
            poses[int(frame)] = pose_of(UnrealPose(*map(number_of, values)))
        except ValueError as error:
            raise DataError(f"{path}: frame {frame}: {error}") from error
    if not poses:
        raise DataError(f"{path}: there is no 'frame=..., ... Transform(Location(...), Rotation(...))' in it")
    return poses


def read_points(path: Path) -> tuple[Float32[np.ndarray, "P 3"], UInt8[np.ndarray, " P"]]:
    """Return points (m) and CARLA's tags of a file with six numbers for each ray: x, y, z, cosine, object, tag.

    Rays that did not come back are left out.
    The dataset's code does not say how these are stored. Tags are read as CARLA writes them (uint32) or as float32,
    whichever the file can be.

    Raises:
        DataError: if the file is missing or damaged, or its last numbers are no tags.
    """
    rows = read_rows(path, 6)
    rows = rows[came_back(rows[:, :3])]
    # 1.0 as float32 has the bits of 1,065,353,216: what is above 255 as uint32 was no tag of CARLA's
    tags, floats = rows[:, 5].copy().view("<u4"), rows[:, 5]
    if tags.max(initial=0) > 255:
        if not ((floats >= 0) & (floats <= 255) & (floats == np.round(floats))).all():
            raise DataError(f"{path}: the last of the six numbers of a point is no tag of 0 to 255 for all points")
        tags = floats
    return rows[:, :3], tags.astype(np.uint8)
