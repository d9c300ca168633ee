"""KITTI-360 as a source: real fisheyes, ranges from the Velodyne for the depth stage, voxels voted by its points."""

from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np
import torch
from jaxtyping import Bool, UInt8
from torch import Tensor

from omniocc.camera import Equirectangular, Rig
from omniocc.classes import OCCUPANCY_CLASSES, UNKNOWN
from omniocc.data.formats.clouds import read_scan
from omniocc.data.formats.dataset_scene import Cloud, DatasetScene, outside
from omniocc.data.formats.files import check_root, read_image, scaled_size
from omniocc.data.formats.index import Index
from omniocc.data.formats.kitti360 import (
    FISHEYES,
    FLIP,
    RECTIFIED,
    SEQUENCE,
    SIZE,
    above_car,
    image_file,
    mounted,
    read_numbered_poses,
    scan_file,
    velodyne_pose,
)
from omniocc.data.formats.poses import inverse, shift, transform_points
from omniocc.data.labels.own_grid import OwnGridLabels, VotedLabels
from omniocc.data.labels.visible import MASKS, MaskKind, field_of_view_mask, ray_traced_mask
from omniocc.data.labels.voxels import vote
from omniocc.data.source import (
    SPLITS,
    Benchmark,
    BenchmarkFrame,
    Ignore,
    Points,
    SceneFrames,
    SourceSpec,
    Split,
    refuse_unseen,
)
from omniocc.data.store.shard import digest
from omniocc.geometry import Cuboid, Grid

ORIGIN_M = (1.15027, -0.299735, 0.86067)
"""Our ego origin in the IMU frame with z up: the mean place of the four cameras, whichever of them are used."""
ROAD_Z_M = -1.75
OWN_CAR_M = ((-3.2, -1.0, -1.8), (1.8, 1.0, 0.1))
"""Lowest and highest x, y, z of the own car, our ego frame; points in it are left out."""


class Drive(NamedTuple):
    """The frames of one sequence that have a pose.

    Attributes:
        numbers: of the frames.
        world_from_imu: pose of each.
    """

    numbers: np.ndarray
    world_from_imu: np.ndarray


class KITTI360:
    """A source (`SceneSource`) of KITTI-360's raw recordings.

    Args:
        root: folder with `calibration`, `data_2d_raw`, `data_3d_raw` and `data_poses`.
        sequences: numbers of the sequences of train, val and test.
        cameras: image_02 (fisheye, left), image_03 (fisheye, right), image_00 and image_01 (ahead, rectified).
        frame_step: every how many-th frame with a pose is taken; 9.6 are recorded a second.
        accumulate: frames with a pose before and after each whose points vote for its voxels too; things that move
            leave traces.
        volume: `shape` (cells along x, y, z) and `cell_m` of a volume with the ego origin in its middle, as OccTrack360
            has: labels are voted and scored in it. None: in the grid of the model.
        masks: which cells of the volume count in scores, and are known with `ignore=unseen`: those in the
            field_of_view of the cameras, those that are ray_traced, or both (`omniocc.data.labels.visible`).
        image_width: of the images that the model gets, px; the height follows, a multiple of 8.
        panorama: width and height (px), upper and lower edge (deg) of the panoramas of ranges.
        cache: folder for the index and class statistics; None: `omniocc` in root.

    Raises:
        ValueError: naming the argument that is impossible.
    """

    def __init__(
        self,
        root: str,
        sequences: Mapping[Split, Sequence[str]],
        cameras: Sequence[str],
        frame_step: int,
        accumulate: int,
        volume: Mapping[str, Any] | None,
        masks: Sequence[MaskKind],
        image_width: int,
        panorama: tuple[int, int, float, float],
        cache: str | None,
    ):
        if image_width < 8 or frame_step < 1 or accumulate < 0:
            given = f"{image_width}, {frame_step} and {accumulate}"
            raise ValueError(f"image_width must be at least 8, frame_step 1 and accumulate 0, got {given}")
        if set(sequences) != set(SPLITS):
            raise ValueError(f"sequences need {', '.join(SPLITS)}, got {dict(sequences)}")
        if not cameras or not set(cameras) <= {*RECTIFIED, *FISHEYES}:
            raise ValueError(f"cameras must be of {', '.join((*RECTIFIED, *FISHEYES))}, got {list(cameras)}")
        if not set(masks) <= set(MASKS):
            raise ValueError(f"masks must be of {', '.join(MASKS)}, got {list(masks)}")
        self.volume = None if volume is None else centered(volume["shape"], volume["cell_m"])
        self.masks = tuple(masks)
        self.sequences = {split: [str(number).zfill(2) for number in sequences[split]] for split in SPLITS}
        self.root, self.cameras = root, tuple(cameras)
        self.frame_step, self.accumulate, self.image_width = frame_step, accumulate, image_width
        self.panorama = Equirectangular(*panorama)
        self.folder = Path(root, "omniocc") if cache is None else Path(cache)
        names = sorted({name for split in SPLITS for name in self.sequences[split]})
        self.index = Index(self.folder / f"index-kitti360-{digest(names)[:8]}", Drive, self._read_poses)

    @property
    def spec(self) -> SourceSpec:
        """Return two classes, free and occupied: the points have no others."""
        benchmark = None if self.volume is None else Benchmark(self.volume)
        return SourceSpec(OCCUPANCY_CLASSES, (0.0, 8.5, 17.0, 25.6), self.frame_step / 9.6, ROAD_Z_M, None, benchmark)

    @property
    def fingerprint(self) -> str:
        """Return a hash of the frames, of cameras, sizes and steps."""
        options = [self.cameras, self.frame_step, self.accumulate, self.image_width, repr(self.panorama)]
        options += [] if self.volume is None else [repr(self.volume), self.masks]
        return digest([self.index.fingerprint, {split: list(self.sequences[split]) for split in SPLITS}, options])

    def prepare(self) -> None:
        """Check the folders and build the index from the poses if it is missing.

        Raises:
            DataError: naming what is missing or wrong.
        """
        folders = ["calibration", "data_2d_raw", "data_3d_raw", "data_poses"]
        check_root(self.root, folders, "unpack KITTI-360's images, scans, poses and calibration into it")
        self.index.prepare()
        _ = self.rig

    def scenes(self, split: Split) -> Sequence["KITTI360Scene"]:
        """Return the sequences of a split."""
        return [KITTI360Scene(name, self) for name in self.sequences[split]]

    def labels(self, geometry: Grid, ignore: Ignore) -> VotedLabels | OwnGridLabels:
        """Return voxels voted by the accumulated points when they are asked for; with a volume first in its grid.

        Raises:
            ValueError: for `unseen` without a volume and masks.
        """
        if self.volume is None or not self.masks:
            volume = "data.source.volume='{shape:[256,256,32],cell_m:0.2}'"
            refuse_unseen(ignore, f"choose none or unobserved, or a volume with masks, such as {volume}")
        classes = OCCUPANCY_CLASSES.num_classes
        if self.volume is None:
            return VotedLabels(self.folder, self.fingerprint, geometry, classes, ignore)
        return OwnGridLabels(self.folder, self.fingerprint, self.volume, geometry, classes, ignore)

    @cached_property
    def in_view(self) -> Bool[Tensor, "X Y Z"]:
        """Return the cells of the volume in the field of view, the same in every frame."""
        assert self.volume is not None
        return field_of_view_mask(self.volume, self.rig)

    @cached_property
    def rig(self) -> Rig:
        """Return the cameras of all frames."""
        cameras, poses, masks = [], [], []
        for name in self.cameras:
            camera, imu_from_camera = mounted(Path(self.root, "calibration"), name)
            cameras.append(camera.resized(*scaled_size(camera.width, camera.height, self.image_width)))
            poses.append(ego_from_imu() @ imu_from_camera)
            masks.append(above_car(cameras[-1]) if name in FISHEYES else None)
        return Rig(tuple(cameras), torch.from_numpy(np.stack(poses)), self.cameras, tuple(masks), ROAD_Z_M)

    def _read_poses(self) -> dict[str, Drive]:
        names = sorted({name for split in SPLITS for name in self.sequences[split]})
        folder = Path(self.root, "data_poses")
        return {name: Drive(*read_numbered_poses(folder / SEQUENCE.format(name) / "poses.txt")) for name in names}


class KITTI360Scene(DatasetScene):
    """The frames of one sequence that have a pose, every `frame_step`-th."""

    dataset = "KITTI-360"

    def __init__(self, name: str, source: KITTI360):
        super().__init__(name, source.panorama)
        self.root, self.index, self.rig = Path(source.root), source.index, source.rig
        self.step, self.accumulate = source.frame_step, source.accumulate
        self.cameras, self.source = source.cameras, source

    def __len__(self) -> int:
        return -(-len(self.index.read(self.name).numbers) // self.step)

    @cached_property
    def world_from_ego(self) -> np.ndarray:
        """Return the pose of every frame."""
        return (self.index.read(self.name).world_from_imu @ inverse(ego_from_imu()))[:: self.step]

    @cached_property
    def rigs(self) -> tuple[Rig, ...]:
        """Return the cameras of every frame: always the same."""
        return (self.rig,) * len(self)

    @cached_property
    def ego_from_velodyne(self) -> np.ndarray:
        """Return the pose of the Velodyne, from the calibration."""
        return ego_from_imu() @ velodyne_pose(self.root / "calibration")

    def images(self, frame: int) -> list[np.ndarray]:
        """Return the images, scaled."""
        number = int(self.index.read(self.name).numbers[frame * self.step])
        with self.naming(frame):
            return [
                read_image(
                    image_file(self.root, self.name, name, number),
                    SIZE if name in RECTIFIED else (1400, 1400),
                    (camera.width, camera.height),
                )
                for name, camera in zip(self.cameras, self.rig.cameras, strict=True)
            ]

    def cloud(self, frame: int) -> Cloud:
        """Return the points of one scan; their classes are not known."""
        with self.naming(frame):
            points_m, origin_m = self._scan(frame * self.step)
        return Cloud(points_m[outside(points_m, *OWN_CAR_M)], None, origin_m)

    def points(self, frame: int) -> Points:
        """Return the points of this scan and of its neighbours, in the ego frame of this one; all are 'occupied'."""
        poses, center = self.index.read(self.name).world_from_imu, frame * self.step
        found = []
        for other in range(max(0, center - self.accumulate), min(len(poses), center + self.accumulate + 1)):
            with self.naming(frame):
                points_m = self._scan(other)[0]
            kept = points_m[outside(points_m, *OWN_CAR_M)]
            here = ego_from_imu() @ inverse(poses[center]) @ poses[other] @ inverse(ego_from_imu())
            found.append(transform_points(here, kept).astype(np.float32))
        all_m = np.concatenate(found)
        return Points(all_m, np.ones(len(all_m), np.uint8))

    def own_voxels(self, frame: int, ignore: Ignore) -> UInt8[Tensor, "X Y Z"]:
        """Return the class of every cell of the volume; with `unseen` unknown where a mask leaves it out."""
        assert self.source.volume is not None
        voxels = vote(cast(SceneFrames, self), frame, self.source.volume, "none" if ignore == "unseen" else ignore, 2)
        return voxels.masked_fill(~self.seen(voxels), UNKNOWN) if ignore == "unseen" else voxels

    def benchmark(self, frame: int) -> BenchmarkFrame:
        """Return the voxels of the volume, of which those count that no mask leaves out."""
        voxels = self.own_voxels(frame, "none")
        return BenchmarkFrame(voxels, self.seen(voxels))

    def seen(self, voxels: UInt8[Tensor, "X Y Z"]) -> Bool[Tensor, "X Y Z"]:
        """Return the cells of the volume that no mask leaves out, given the classes of all."""
        source, kept = self.source, torch.ones(voxels.shape, dtype=torch.bool)
        assert source.volume is not None
        if "field_of_view" in source.masks:
            kept &= source.in_view
        if "ray_traced" in source.masks:
            kept &= ray_traced_mask(source.volume, voxels, self.rig)
        return kept

    def _scan(self, place: int) -> tuple[np.ndarray, np.ndarray]:
        """Return points and place of the Velodyne in the ego frame, m, of a frame that has a pose."""
        number = int(self.index.read(self.name).numbers[place])
        path = scan_file(self.root, self.name, number)
        points, _ = read_scan(path, 4)
        return transform_points(self.ego_from_velodyne, points).astype(np.float32), self.ego_from_velodyne[:3, 3]


def centered(shape: Sequence[int], cell_m: float) -> Cuboid:
    """Return a volume with the ego origin in its middle: place (128, 128, 16) of 256 x 256 x 32 begins there."""
    half = [cells * cell_m / 2 for cells in shape]
    return Cuboid(shape, *[(-length, length) for length in half])


def ego_from_imu() -> np.ndarray:
    """Return the pose of the IMU frame (x forward, y right, z down) in our ego frame, (4, 4)."""
    return shift(*(-value for value in ORIGIN_M)) @ FLIP
