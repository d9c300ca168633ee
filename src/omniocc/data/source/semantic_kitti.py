"""Read SemanticKITTI's semantic scene completion: images of two cameras ahead, voxels of 0.2 m, the invalid mask."""

import re
import warnings
from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from pathlib import Path

import numpy as np
import torch
from jaxtyping import UInt8
from torch import Tensor

from omniocc.camera import Pinhole, Rig
from omniocc.data.formats.clouds import read_scan
from omniocc.data.formats.dataset_scene import Cloud
from omniocc.data.formats.files import check_root, image_size, read_image, scaled_size
from omniocc.data.formats.kitti import (
    SEMANTIC_KITTI,
    SEMANTIC_KITTI_IDS,
    camera_of,
    is_first_release,
    read_calibration,
    read_mask,
    read_point_classes,
    read_poses,
)
from omniocc.data.formats.poses import rigid
from omniocc.data.source import Ignore, Split
from omniocc.data.source.completion import ROAD_Z_M, CompletionScene, CompletionSource, unknown_where, voxel_grid
from omniocc.data.store.shard import digest
from omniocc.errors import DataError, reason_of
from omniocc.geometry import Cuboid

CAMERAS = ("image_2", "image_3")
MAX_CENTER_OFFSET = 0.25
"""Distance from the middle of an image to its principal point, as a fraction of its size; in KITTI it is less."""
ARCHIVES = {
    "calib.txt": "KITTI odometry's archive of Velodyne scans",
    "poses.txt": "SemanticKITTI's archive of labels",
    "voxels": "SemanticKITTI's archive of voxels",
    **dict.fromkeys(CAMERAS, "KITTI odometry's archive of colour images"),
}
"""The archive that holds each file or folder of a sequence."""


class SemanticKITTI(CompletionSource["KittiSequence"]):
    """A source (`SceneSource`) of every fifth frame of KITTI odometry: those that have voxels.

    Sequence 08, the official validation, is the test, since results are published on it. Sequence 04 is kept from
    training for validation. The labels of sequences 11 to 21 are secret: these can be predicted
    (`predict.py submission`), but not scored.

    Args:
        root: folder with `sequences/00` and so on, each with calib.txt (of the Velodyne archive), poses.txt, voxels and
            the folders of `cameras`; velodyne (scans) and labels (of points) are optional.
        sequences: numbers of the sequences of train, val and test.
        cameras: folders of the images: image_2 (left), image_3 (right).
        image_width: see `CompletionSource`.
        panorama: see `CompletionSource`.
        cache: see `CompletionSource`.

    Raises:
        ValueError: if a camera, a split or the width is not allowed.
    """

    classes = SEMANTIC_KITTI

    def __init__(
        self,
        root: str,
        sequences: Mapping[Split, Sequence[str]],
        cameras: Sequence[str],
        image_width: int,
        panorama: tuple[int, int, float, float],
        cache: str | None,
    ):
        super().__init__(root, sequences, image_width, panorama, cache)
        if not cameras or not set(cameras) <= set(CAMERAS):
            raise ValueError(f"cameras must be {', '.join(CAMERAS)} or both, got {list(cameras)}")
        self.cameras = tuple(cameras)

    @cached_property
    def grid(self) -> Cuboid:
        """Return the voxel grid, velodyne frame; warn if the files are of the first release, one cell too high."""
        files = [path for scene in list(self.all_scenes.values())[:3] for path in scene.occupied_files[:3]]
        masks = [path for path in files if path.exists()]
        first_release = bool(masks) and is_first_release(np.stack([read_mask(path) for path in masks]))
        if first_release:
            warnings.warn(
                f"{self.root}: the voxels are of SemanticKITTI's first release, one cell too high; they are moved down",
                stacklevel=2,
            )
        return voxel_grid(first_release)

    @property
    def fingerprint(self) -> str:
        """Return a hash of the frames of every sequence, the cameras, the sizes and the grid."""
        return digest([self.frames, self.cameras, self.image_width, repr(self.panorama), repr(self.grid)])

    def prepare(self) -> None:
        """Check that every sequence has its files, and labels unless it is tested only.

        Raises:
            DataError: naming what is missing or wrong.
        """
        check_root(self.root, ["sequences"], "give the folder that holds SemanticKITTI's 'sequences'")
        problems = [line for name, scene in self.all_scenes.items() for line in self._find_problems(name, scene)]
        if problems:
            raise DataError("\n".join(problems))

    def _find_problems(self, name: str, scene: "KittiSequence") -> Iterator[str]:
        wanted = ["calib.txt", "poses.txt", "voxels", *self.cameras]
        for part in (part for part in wanted if not (scene.folder / part).exists()):
            yield f"{scene.folder / part} is missing: unpack {ARCHIVES[part]} into data.source.root"
        if (scene.folder / "voxels").is_dir() and not len(scene):
            yield f"{scene.folder / 'voxels'}: there are no *.label or *.bin files; unpack {ARCHIVES['voxels']}"
        if len(scene) and not scene.labelled and name not in self.sequences["test"]:
            yield f"{scene.folder / 'voxels'}: there are no *.label files, from which training and validation learn"

    def sequence(self, name: str) -> "KittiSequence":
        """Return a sequence by its number."""
        return KittiSequence(Path(self.root, "sequences", name), self)


class KittiSequence(CompletionScene):
    """The frames of one sequence that have voxels."""

    dataset, ids = "SemanticKITTI", SEMANTIC_KITTI_IDS

    def __init__(self, folder: Path, source: SemanticKITTI):
        super().__init__(folder.name, source.panorama)
        self.folder, self.cameras, self.image_width = folder, source.cameras, source.image_width
        self.source = source

    @property
    def cells_up(self) -> int:
        """Return 1 if the files are of the first release, whose voxels lie one cell too high; else 0."""
        return int(self.source.grid != voxel_grid())

    @cached_property
    def numbers(self) -> list[int]:
        """Return the numbers of the frames with voxel labels; of those with occupied voxels where labels are secret."""
        return self._frame_numbers("label") or self._frame_numbers("bin")

    @cached_property
    def labelled(self) -> bool:
        """Return whether the sequence has voxel labels."""
        return bool(self._frame_numbers("label"))

    @property
    def occupied_files(self) -> list[Path]:
        """Return the `.bin` file of every frame: the voxels that its own scan hits."""
        return [self._file("voxels", frame, "bin") for frame in range(len(self))]

    @cached_property
    def calibration(self) -> dict[str, np.ndarray]:
        """Return the matrices of calib.txt."""
        return read_calibration(self.folder / "calib.txt")

    @cached_property
    def world_from_ego(self) -> np.ndarray:
        """Return the pose of the velodyne in every frame that has voxels."""
        path = self.folder / "poses.txt"
        poses = read_poses(path, rigid(self.calibration["Tr"], "Tr"))
        if self.numbers and self.numbers[-1] >= len(poses):
            raise DataError(f"{path}: it has {len(poses)} poses, but there are voxels of frame {self.numbers[-1]}")
        return poses[self.numbers]

    @cached_property
    def sizes(self) -> list[tuple[int, int]]:
        """Return width and height of each camera's images, which differ between sequences."""
        with self.naming(0):
            return [image_size(self._file(camera, 0, "png")) for camera in self.cameras]

    @cached_property
    def rig(self) -> Rig:
        """Return the cameras, the same in every frame."""
        cameras, poses = [], []
        for name, (width, height) in zip(self.cameras, self.sizes, strict=True):
            try:
                intrinsics, pose = camera_of(self.calibration, int(name[-1]))
            except ValueError as error:
                raise DataError(f"{self.folder / 'calib.txt'}: {reason_of(error)}") from error
            focal_px = (float(intrinsics[0, 0]), float(intrinsics[1, 1]))
            center_px = (float(intrinsics[0, 2]), float(intrinsics[1, 2]))
            offsets = (abs(center_px[0] / width - 0.5), abs(center_px[1] / height - 0.5))
            if not all(offset < MAX_CENTER_OFFSET for offset in offsets):
                raise DataError(
                    f"{self._file(name, 0, 'png')}: the image has {width}x{height} px, but calib.txt has its "
                    f"middle near ({center_px[0]:g}, {center_px[1]:g}) px; it is damaged, or of another sequence"
                )
            camera = Pinhole(width, height, focal_px, center_px)
            cameras.append(camera.resized(*scaled_size(width, height, self.image_width)))
            poses.append(torch.from_numpy(pose))
        return Rig(tuple(cameras), torch.stack(poses), self.cameras, None, ROAD_Z_M)

    def images(self, frame: int) -> list[np.ndarray]:
        """Return the images, scaled to the cameras of the rig."""
        with self.naming(frame):
            return [
                read_image(self._file(name, frame, "png"), size, (camera.width, camera.height))
                for name, size, camera in zip(self.cameras, self.sizes, self.rig.cameras, strict=True)
            ]

    def cloud(self, frame: int) -> Cloud | None:
        """Return the points of the scan, and their classes if the sequence has point labels; None without scans."""
        if not (self.folder / "velodyne").is_dir():
            return None
        with self.naming(frame):
            points, kept = read_scan(self._file("velodyne", frame, "bin"), 4)
            labels = None
            if (self.folder / "labels").is_dir():
                labels = read_point_classes(self._file("labels", frame, "label"), self.table, kept)
        return Cloud(points, labels, np.zeros(3))

    def own_voxels(self, frame: int, ignore: Ignore) -> UInt8[Tensor, "X Y Z"] | None:
        """Return the class of every cell; None where labels are secret. Invalid cells are unknown, as in the benchmark.

        With `unobserved` the free cells of the `.occluded` file are unknown too: the first scan could not see them.
        """
        if not self.labelled:
            return None
        with self.naming(frame):
            labels = self.voxels_of(self._file("voxels", frame, "label"))
            unknown = read_mask(self._file("voxels", frame, "invalid"))
            if ignore == "unobserved":
                unknown = unknown | (read_mask(self._file("voxels", frame, "occluded")) & (labels == 0))
        return unknown_where(labels, unknown)

    def _frame_numbers(self, extension: str) -> list[int]:
        found = (re.fullmatch(rf"(\d{{6}})\.{extension}", path.name) for path in (self.folder / "voxels").glob("*"))
        return sorted(int(match[1]) for match in found if match)

    def _file(self, kind: str, frame: int, extension: str) -> Path:
        return self.folder / kind / f"{self.numbers[frame]:06d}.{extension}"
