"""SemanticKITTI's semantic scene completion as a source: two cameras ahead, voxels of .2 m, the invalid mask."""

import re
import warnings
from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path

import cv2
import numpy as np
import torch
from jaxtyping import UInt8
from torch import Tensor

from omniocc.camera import Equirectangular, Pinhole, Rig
from omniocc.classes import UNKNOWN
from omniocc.data.formats.files import check_root, read_array, read_bytes, read_image, scaled_size
from omniocc.data.formats.kitti import (
    CELL_M,
    LOW_M,
    SEMANTIC_KITTI,
    SEMANTIC_KITTI_IDS,
    SHAPE,
    camera_of,
    classes_by_id,
    is_first_release,
    read_calibration,
    read_mask,
    read_point_classes,
    read_poses,
    read_voxels,
    write_prediction,
)
from omniocc.data.formats.poses import rigid
from omniocc.data.formats.scene import Cloud, DatasetScene
from omniocc.data.labels.own_grid import OwnGridLabels
from omniocc.data.source import SPLITS, Benchmark, BenchmarkFrame, SourceSpec, Split, Unknown
from omniocc.data.store.shard import digest
from omniocc.errors import DataError
from omniocc.geometry import Cuboid, Grid

ROAD_Z_M = -1.73
TABLE = classes_by_id(SEMANTIC_KITTI_IDS)
PARTS = (("12.8m", (0.0, 12.8), (-6.4, 6.4)), ("25.6m", (0.0, 25.6), (-12.8, 12.8)))
"""Nearer parts in which methods are compared as well, beside all 51.2 m."""
RANGE_EDGES_M = (0.0, 12.8, 25.6, 51.2)
LABELS = "unpack SemanticKITTI's voxel archive into data.source.root"


def voxel_grid(first_release: bool = False) -> Cuboid:
    """Return the voxels, velodyne frame; those of the first release lie one cell higher in the files."""
    low = (LOW_M[0], LOW_M[1], LOW_M[2] - CELL_M * first_release)
    ends = [(start, start + cells * CELL_M) for start, cells in zip(low, SHAPE, strict=True)]
    return Cuboid(SHAPE, *[(round(start, 6), round(end, 6)) for start, end in ends])


class SemanticKITTI:
    """A source (`SceneSource`) of the frames of KITTI odometry that have voxels: every fifth.

    The ego frame is that of the velodyne. Sequence 08, the official validation, is the test, since results are
    published on it; labels of 11 to 21 are secret. Of the training sequences 04 is kept for validation.

    Args:
        root: folder with `sequences/00` and so on, each with calib.txt (of the Velodyne archive), poses.txt, voxels,
            image_2, image_3 and velodyne; point labels are optional.
        sequences: numbers of the sequences of train, val and test.
        cameras: folders of the images: image_2 (left), image_3 (right).
        image_width: of the images that the model gets, px; the height follows, a multiple of 8.
        panorama: width and height (px), upper and lower edge (deg) of the panoramas of ranges.
        cache: folder for class statistics; None: `omniocc` in root.

    Raises:
        ValueError: if a camera, a split or the width is impossible.
    """

    def __init__(
        self, root: str, sequences: Mapping[Split, Sequence[str]], cameras: Sequence[str], image_width: int,
        panorama: tuple[int, int, float, float], cache: str | None,
    ):  # fmt: skip
        if image_width < 8 or set(sequences) != set(SPLITS):
            given = f"{image_width} and {dict(sequences)}"
            raise ValueError(f"image_width must be at least 8 and sequences need {', '.join(SPLITS)}, got {given}")
        if not cameras or not set(cameras) <= {"image_2", "image_3"}:
            raise ValueError(f"cameras must be image_2, image_3 or both, got {list(cameras)}")
        self.root, self.sequences, self.cameras = root, sequences, tuple(cameras)
        self.image_width = image_width
        self.panorama = Equirectangular(*panorama)
        self.folder = Path(root, "omniocc") if cache is None else Path(cache)

    @property
    def spec(self) -> SourceSpec:
        """Return classes, bands and the protocol: cells that are not invalid, in 12.8, 25.6 and 51.2 m."""
        benchmark = Benchmark(self.grid, parts=PARTS)
        return SourceSpec(SEMANTIC_KITTI, RANGE_EDGES_M, 0.5, ROAD_Z_M, None, benchmark)

    @cached_property
    def grid(self) -> Cuboid:
        """Return the voxels in the velodyne frame; warn if they are of the first release, one cell too high."""
        masks = [path for scene in self._all[:3] for path in scene.occupied_files[:3] if path.exists()]
        first = bool(masks) and is_first_release(np.stack([read_mask(path) for path in masks]))
        if first:
            warnings.warn(
                f"{self.root}: the voxels are of SemanticKITTI's first release, one cell too high; they are moved down",
                stacklevel=2,
            )
        return voxel_grid(first)

    @property
    def fingerprint(self) -> str:
        """Return a hash of the frames of every sequence, of cameras and sizes."""
        frames = [[split, scene.name, scene.numbers] for split in SPLITS for scene in self.scenes(split)]
        return digest([frames, self.cameras, self.image_width, repr(self.panorama), repr(self.grid)])

    def prepare(self) -> None:
        """Check that the sequences are there.

        Raises:
            DataError: naming what is missing or wrong.
        """
        check_root(self.root, ["sequences"], "give the folder that holds SemanticKITTI's 'sequences'")
        for scene in self._all:
            check_root(str(scene.folder), ["calib.txt", "poses.txt", "voxels", *self.cameras], LABELS)
            if not len(scene):
                raise DataError(f"{scene.folder / 'voxels'}: there are no *.label files; {LABELS}")

    def scenes(self, split: Split) -> Sequence["KittiSequence"]:
        """Return the sequences of a split."""
        return [scene for scene in self._all if scene.name in self.sequences[split]]

    def labels(self, geometry: Grid, unknown: Unknown) -> OwnGridLabels:
        """Return the voxels in a grid; with `unobserved` free cells that the first scan could not see are unknown.

        Raises:
            ValueError: for `unseen`: there is no mask of what the cameras see.
        """
        if unknown == "unseen":
            raise ValueError(
                "data.unknown=unseen: SemanticKITTI has no mask of what cameras see; use free | unobserved"
            )
        classes = SEMANTIC_KITTI.num_classes
        return OwnGridLabels(self.folder, self.fingerprint, self.grid, geometry, classes, unknown)

    @cached_property
    def _all(self) -> list["KittiSequence"]:
        names = [name for split in SPLITS for name in self.sequences[split]]
        return [KittiSequence(Path(self.root, "sequences", name), self) for name in names]


class KittiSequence(DatasetScene):
    """The frames of one sequence that have voxels."""

    dataset = "SemanticKITTI"

    def __init__(self, folder: Path, source: SemanticKITTI):
        super().__init__(folder.name, source.panorama)
        self.folder, self.cameras, self.image_width = folder, source.cameras, source.image_width

    def __len__(self) -> int:
        return len(self.numbers)

    @cached_property
    def numbers(self) -> list[int]:
        """Return the numbers of the frames with voxel labels."""
        found = (re.fullmatch(r"(\d{6})\.label", path.name) for path in (self.folder / "voxels").glob("*.label"))
        return sorted(int(match[1]) for match in found if match)

    @property
    def occupied_files(self) -> list[Path]:
        """Return the files of the voxels that the single scans hit."""
        return [self._file("voxels", frame, "bin") for frame in range(len(self))]

    @cached_property
    def calibration(self) -> dict[str, np.ndarray]:
        """Return the matrices of calib.txt."""
        return read_calibration(self.folder / "calib.txt")

    @cached_property
    def world_from_ego(self) -> np.ndarray:
        """Return the pose of the velodyne in every frame."""
        path = self.folder / "poses.txt"
        poses = read_poses(path, rigid(self.calibration["Tr"], "Tr"))
        if self.numbers and self.numbers[-1] >= len(poses):
            raise DataError(f"{path}: it has {len(poses)} poses, but there are voxels of frame {self.numbers[-1]}")
        return poses[self.numbers]

    @cached_property
    def sizes(self) -> list[tuple[int, int]]:
        """Return width and height of each camera's files, which differ from sequence to sequence."""
        return [image_size(self.folder / camera / f"{self.numbers[0]:06d}.png") for camera in self.cameras]

    @cached_property
    def rigs(self) -> tuple[Rig, ...]:
        """Return the cameras of every frame: always the same."""
        cameras, poses = [], []
        for name, (width, height) in zip(self.cameras, self.sizes, strict=True):
            k, pose = camera_of(self.calibration, int(name[-1]))
            camera = Pinhole(width, height, (float(k[0, 0]), float(k[1, 1])), (float(k[0, 2]), float(k[1, 2])))
            cameras.append(camera.resized(*scaled_size(width, height, self.image_width)))
            poses.append(torch.from_numpy(pose))
        rig = Rig(tuple(cameras), torch.stack(poses), self.cameras, None, ROAD_Z_M)
        return (rig,) * len(self)

    def images(self, frame: int) -> list[np.ndarray]:
        """Return the images, scaled."""
        with self.naming(frame):
            return [
                read_image(self._file(name, frame, "png"), size, (camera.width, camera.height))
                for name, size, camera in zip(self.cameras, self.sizes, self.rigs[frame].cameras, strict=True)
            ]

    def cloud(self, frame: int) -> Cloud | None:
        """Return the points of the scan, with classes where SemanticKITTI's point labels are there."""
        if not (self.folder / "velodyne").is_dir():
            return None
        with self.naming(frame):
            points = read_array(self._file("velodyne", frame, "bin"), "<f4", (-1, 4))[:, :3]
            labels = None
            if (self.folder / "labels").is_dir():
                labels = read_point_classes(self._file("labels", frame, "label"), TABLE, len(points))
        return Cloud(points, labels, np.zeros(3))

    def own_voxels(self, frame: int, unknown: Unknown) -> UInt8[Tensor, "X Y Z"]:
        """Return the class of every cell; invalid ones are unknown, as the benchmark has it."""
        with self.naming(frame):
            labels = read_voxels(self._file("voxels", frame, "label"), TABLE)
            labels[read_mask(self._file("voxels", frame, "invalid"))] = UNKNOWN
            if unknown == "unobserved":
                labels[read_mask(self._file("voxels", frame, "occluded")) & (labels == 0)] = UNKNOWN
        return torch.from_numpy(labels)

    def benchmark(self, frame: int) -> BenchmarkFrame:
        """Return the voxels; all count that are not unknown."""
        return BenchmarkFrame(self.own_voxels(frame, "free"))

    def prediction_file(self, frame: int) -> str:
        """Return the place of a frame's file in a submission."""
        return f"sequences/{self.name}/predictions/{self.numbers[frame]:06d}.label"

    def write_prediction(self, path: Path, classes: UInt8[np.ndarray, "X Y Z"]) -> None:
        """Write classes as ids of 16 bits."""
        write_prediction(path, classes, SEMANTIC_KITTI_IDS)

    def read_prediction(self, path: Path) -> UInt8[np.ndarray, "X Y Z"]:
        """Return the classes of a file of ids; those that do not count are empty."""
        classes = read_voxels(path, TABLE)
        return np.where(classes == UNKNOWN, 0, classes).astype(np.uint8)

    def _file(self, kind: str, frame: int, extension: str) -> Path:
        return self.folder / kind / f"{self.numbers[frame]:06d}.{extension}"


def image_size(path: Path) -> tuple[int, int]:
    """Return width and height of an image file, px; raise DataError if it is missing or damaged."""
    content = np.frombuffer(read_bytes(path), np.uint8)
    image = cv2.imdecode(content, cv2.IMREAD_GRAYSCALE) if len(content) else None
    if image is None:
        raise DataError(f"{path}: the file is no image, or damaged")
    return image.shape[1], image.shape[0]
