"""SSCBench-KITTI-360 as a source: the camera ahead, the two fisheyes where KITTI-360 is there, voxels of .2 m."""

import json
import os
import re
from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path

import numpy as np
import torch
from jaxtyping import UInt8
from torch import Tensor

from omniocc.camera import Camera, Pinhole, Rig
from omniocc.classes import UNKNOWN
from omniocc.data.formats.clouds import read_scan
from omniocc.data.formats.dataset_scene import Cloud
from omniocc.data.formats.files import check_root, class_table, map_classes, read_image, read_npy, scaled_size
from omniocc.data.formats.kitti import SHAPE, SSCBENCH, SSCBENCH_IDS, read_mask
from omniocc.data.formats.kitti360 import (
    FISHEYES,
    SEQUENCE,
    SIZE,
    above_car,
    image_file,
    match_frames,
    mounted,
    read_numbered_poses,
    scan_file,
    velodyne_pose,
)
from omniocc.data.formats.poses import inverse, rigid
from omniocc.data.source import Ignore, Split
from omniocc.data.source.completion import ROAD_Z_M, CompletionScene, CompletionSource, unknown_where
from omniocc.data.store.shard import digest
from omniocc.errors import FAULTS, DataError
from omniocc.io import atomic_write

FRONT, POSES = "image_00", "pose.txt"
FOCAL_PX, CENTER_PX = 552.554261, (682.049453, 238.769549)
"""Rectified camera 0 of KITTI-360 (perspective.txt); SSCBench's download has no calibration."""
VELODYNE_FROM_CAMERA = (
    (0.04307104361, -0.08829286498, 0.995162929, 0.8043914418),
    (-0.999004371, 0.007784614041, 0.04392796942, 0.2993489574),
    (-0.01162548558, -0.9960641394, -0.08786966659, -0.1770225824),
)
"""calib_cam_to_velo.txt of KITTI-360; of the unrectified camera, as SSCBench's own code takes it."""
R_RECT = ((0.999974, -0.007141, -0.000089), (0.007141, 0.999969, -0.003247), (0.000112, 0.003247, 0.999995))
"""From the unrectified to the rectified camera (perspective.txt, R_rect_00)."""
PREPROCESSED = class_table({number: number for number in (*range(SSCBENCH.num_classes), UNKNOWN)})
"""Class of each id in preprocessed files, which have our ids."""


class SSCBenchKITTI360(CompletionSource["SSCBenchSequence"]):
    """A source (`SceneSource`) of SSCBench-KITTI-360; the ego frame is that of the velodyne.

    Args:
        root: folder with `data_2d_raw/2013_05_28_drive_0000_sync` and so on, each with image_00/data_rect and voxels;
            without voxels `preprocess/labels` is read.
        sequences: numbers of the sequences of train, val and test.
        kitti360: folder of KITTI-360 itself, whose two fisheyes and scans are added; its frames are found by comparing
            images, once. None: the camera ahead alone.
        image_width: see `CompletionSource`.
        panorama: see `CompletionSource`.
        cache: see `CompletionSource`.

    Raises:
        ValueError: if a split or the width is impossible.
    """

    classes = SSCBENCH

    def __init__(
        self,
        root: str,
        sequences: Mapping[Split, Sequence[str]],
        kitti360: str | None,
        image_width: int,
        panorama: tuple[int, int, float, float],
        cache: str | None,
    ):
        super().__init__(root, sequences, image_width, panorama, cache)
        self.kitti360 = kitti360

    @property
    def fingerprint(self) -> str:
        """Return a hash of the frames of every sequence, of cameras and sizes."""
        return digest([self.frames, self.kitti360 is not None, self.image_width, repr(self.panorama)])

    def prepare(self) -> None:
        """Check that the sequences are there, and find the frames of KITTI-360 that are not found yet.

        Raises:
            DataError: naming what is missing or wrong.
        """
        check_root(self.root, ["data_2d_raw"], "give the folder that holds SSCBench-KITTI-360's 'data_2d_raw'")
        if self.kitti360 is not None:
            folders = ["calibration", "data_2d_raw"]
            check_root(self.kitti360, folders, "give KITTI-360's own folder", "data.source.kitti360=")
        for scene in self.all_scenes.values():
            check_root(str(scene.folder), [FRONT], "unpack SSCBench-KITTI-360 into data.source.root", "")
            if not len(scene):
                raise DataError(f"{scene.folder}: there are no voxels/*.label, and no *_1_1.npy in preprocess/labels")
            scene.find_fisheyes()

    def sequence(self, name: str) -> "SSCBenchSequence":
        """Return a sequence by its number."""
        return SSCBenchSequence(name, self)


class SSCBenchSequence(CompletionScene):
    """The frames of one sequence that have voxels: every fifth."""

    dataset, ids = "SSCBench-KITTI-360", SSCBENCH_IDS

    def __init__(self, name: str, source: SSCBenchKITTI360):
        super().__init__(name, source.panorama)
        self.folder = Path(source.root, "data_2d_raw", SEQUENCE.format(name))
        self.preprocessed = Path(source.root, "preprocess", "labels", SEQUENCE.format(name))
        self.image_width = source.image_width
        self.kitti360 = None if source.kitti360 is None else Path(source.kitti360)
        self.found = source.folder / f"kitti360-frames-2-{name}.json"

    @cached_property
    def numbers(self) -> list[int]:
        """Return the numbers of the frames with labels."""
        for folder, pattern in ((self.folder / "voxels", r"(\d{6})\.label"), (self.preprocessed, r"(\d{6})_1_1\.npy")):
            names = (path.name for path in folder.iterdir()) if folder.is_dir() else ()
            found = sorted(int(match[1]) for match in (re.fullmatch(pattern, name) for name in names) if match)
            if found:
                return found
        return []

    @property
    def labelled(self) -> bool:
        """Return true: every frame has voxels."""
        return True

    @property
    def has_poses(self) -> bool:
        """Return whether the file of the poses is there."""
        return os.path.lexists(self.folder / POSES)

    @cached_property
    def world_from_ego(self) -> np.ndarray:
        """Return the pose of the velodyne in every frame, from pose.txt; without it all are the same.

        The download has no poses now: then history can't be fused (`model/temporal=none`).
        """
        path = self.folder / POSES
        if not self.has_poses:
            return np.tile(np.eye(4), (len(self), 1, 1))
        known, poses = read_numbered_poses(path)
        place = {int(number): index for index, number in enumerate(known)}
        missing = [number for number in self.numbers if number not in place]
        if missing:
            raise DataError(f"{path}: {len(missing)} frames have voxels but no pose, the first is {missing[0]}")
        return poses[[place[number] for number in self.numbers]]

    @cached_property
    def rig(self) -> Rig:
        """Return the cameras, the same in every frame; the fisheyes with masks that leave out the own car."""
        front = Pinhole(*SIZE, (FOCAL_PX, FOCAL_PX), CENTER_PX)
        turn = np.eye(4)
        turn[:3, :3] = R_RECT
        pose = rigid(np.array(VELODYNE_FROM_CAMERA), FRONT) @ inverse(rigid(turn, "R_rect_00"))
        cameras: list[Camera] = [front.resized(*scaled_size(*SIZE, self.image_width))]
        poses, names = [pose], [FRONT]
        masks: list[Tensor | None] = [None]
        if self.kitti360 is not None:
            calibration = self.kitti360 / "calibration"
            velodyne_from_imu = inverse(velodyne_pose(calibration))
            for name in FISHEYES:
                camera, imu_from_camera = mounted(calibration, name)
                cameras.append(camera.resized(*scaled_size(camera.width, camera.height, self.image_width)))
                poses.append(velodyne_from_imu @ imu_from_camera)
                names.append(name)
                masks.append(above_car(cameras[-1]))
        return Rig(tuple(cameras), torch.from_numpy(np.stack(poses)), tuple(names), tuple(masks), ROAD_Z_M)

    def find_fisheyes(self) -> None:
        """Find the frames of KITTI-360 that are those of this sequence, and keep their numbers.

        Raises:
            DataError: naming the image that is not found.
        """
        if self.kitti360 is None or list(self._found_frames()) == self.numbers:
            return
        kitti360 = sorted(image_file(self.kitti360, self.name, FRONT, 0).parent.glob("*.png"))
        images = [self._image(number) for number in self.numbers]
        found = match_frames(images, kitti360, f"frames of KITTI-360, sequence {self.name}")
        frames = {number: int(kitti360[index].stem) for number, index in zip(self.numbers, found, strict=True)}
        atomic_write(self.found, json.dumps(frames))

    @cached_property
    def numbers_of_kitti360(self) -> list[int]:
        """Return the number of every frame in KITTI-360, after `find_fisheyes`."""
        found = self._found_frames()
        return [found[number] for number in self.numbers]

    def _found_frames(self) -> dict[int, int]:
        """Return the number in KITTI-360 of the frames that were found; none where the file is missing or damaged."""
        try:
            return {int(number): int(theirs) for number, theirs in json.loads(self.found.read_text("utf-8")).items()}
        except (OSError, *FAULTS):
            return {}

    def images(self, frame: int) -> list[np.ndarray]:
        """Return the images, scaled."""
        paths = [self._image(self.numbers[frame])]
        if self.kitti360 is not None:
            number = self.numbers_of_kitti360[frame]
            paths += [image_file(self.kitti360, self.name, name, number) for name in FISHEYES]
        with self.naming(frame):
            return [
                read_image(path, size, (camera.width, camera.height))
                for path, size, camera in zip(paths, [SIZE, None, None], self.rig.cameras, strict=False)
            ]

    def cloud(self, frame: int) -> Cloud | None:
        """Return the points of KITTI-360's scan, whose classes are not known; None without KITTI-360 or its scans."""
        if self.kitti360 is None:
            return None
        with self.naming(frame):
            path = scan_file(self.kitti360, self.name, self.numbers_of_kitti360[frame])
            if not path.parent.is_dir():
                return None
            points, _ = read_scan(path, 4)
        return Cloud(points, None, np.zeros(3))

    def own_voxels(self, frame: int, ignore: Ignore) -> UInt8[Tensor, "X Y Z"]:
        """Return the class of every cell; free ones that are invalid are unknown, as the benchmark has it."""
        number = self.numbers[frame]
        path = self.folder / "voxels" / f"{number:06d}.label"
        with self.naming(frame):
            if not path.exists():
                return torch.from_numpy(read_classes(self.preprocessed / f"{number:06d}_1_1.npy"))
            labels = self.voxels_of(path)
            return unknown_where(labels, read_mask(path.with_suffix(".invalid")) & (labels == 0))

    def _image(self, number: int) -> Path:
        return self.folder / FRONT / "data_rect" / f"{number:06d}.png"


def read_classes(path: Path) -> UInt8[np.ndarray, "256 256 32"]:
    """Return the classes of a preprocessed file, 255 unknown; raise DataError if it is missing or damaged."""
    return map_classes(read_npy(path, SHAPE), PREPROCESSED, path)
