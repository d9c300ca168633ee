"""Occ3D-nuScenes as a source: voxel labels of nuScenes' key frames, six cameras, RayIoU as published."""

import io
from collections.abc import Sequence
from functools import cached_property
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from jaxtyping import Bool, UInt8
from torch import Tensor

from omniocc.camera import Camera, Equirectangular, Pinhole, Rig
from omniocc.classes import FREE, UNKNOWN, ClassTable, SemanticClass
from omniocc.data.formats.clouds import read_scan
from omniocc.data.formats.dataset_scene import Cloud, DatasetScene, outside
from omniocc.data.formats.files import (
    check_root,
    class_table,
    map_classes,
    read_array,
    read_image,
    read_npz,
    scaled_size,
)
from omniocc.data.formats.index import Index
from omniocc.data.formats.nuscenes import CAMERAS, KeyFrames, is_validation, read_key_frames
from omniocc.data.formats.poses import inverse, shift, transform_points
from omniocc.data.labels.own_grid import OwnGridLabels
from omniocc.data.source import Benchmark, BenchmarkFrame, Ignore, SourceSpec, Split
from omniocc.data.store.shard import digest
from omniocc.geometry import Cuboid, Grid
from omniocc.io import atomic_write
from rayiou.directions import RayOrigins, origin_frames

SHAPE = (200, 200, 16)
ORIGIN_M = (0.8, 0.0, 1.8)
"""Our ego origin in the ego frame of nuScenes (on the ground, amid the rear axle). It lies between the cameras, and
puts the cells of Occ3D between z = -2.8 and 3.6 m, like the cells of this project's grids."""
GRID = Cuboid(SHAPE, (-40.8, 39.2), (-40.0, 40.0), (-2.8, 3.6))
"""The voxels of Occ3D (-40 .. 40, -40 .. 40, -1 .. 5.4 m) in our ego frame."""
FREE_ID = 17
"""Free space in the files; every other class has our id less one."""
CLASS_OF_FILE_ID = class_table({number: (number + 1) % (FREE_ID + 1) for number in range(FREE_ID + 1)})
"""Our class for each class id in the files."""
OWN_CAR_M = ((-1.8, -1.1, -1.8), (2.8, 1.1, 0.5))
"""Lowest and highest x, y, z of the own car, our ego frame; LiDAR points within are left out."""
LABELS_REMEDY = "download the labels of Occ3D-nuScenes ('gts') into data.source.root"

CLASSES = ClassTable(
    tuple(
        SemanticClass(number, name, rgb)
        for number, (name, rgb) in enumerate(
            (
                ("free", (255, 255, 255)),
                ("others", (0, 0, 0)),
                ("barrier", (112, 128, 144)),
                ("bicycle", (220, 20, 60)),
                ("bus", (255, 127, 80)),
                ("car", (255, 158, 0)),
                ("construction_vehicle", (233, 150, 70)),
                ("motorcycle", (255, 61, 99)),
                ("pedestrian", (0, 0, 230)),
                ("traffic_cone", (47, 79, 79)),
                ("trailer", (255, 140, 0)),
                ("truck", (255, 99, 71)),
                ("driveable_surface", (0, 207, 191)),
                ("other_flat", (175, 0, 75)),
                ("sidewalk", (75, 0, 75)),
                ("terrain", (112, 180, 60)),
                ("manmade", (222, 184, 135)),
                ("vegetation", (0, 175, 0)),
            )
        )
    )
)
"""Classes of Occ3D, free first; colours of the nuScenes devkit."""

NO_CLASS = 254
FILE_ID_OF_LIDARSEG = class_table(
    {
        9: 1,
        14: 2,
        15: 3,
        16: 3,
        17: 4,
        18: 5,
        21: 6,
        2: 7,
        3: 7,
        4: 7,
        6: 7,
        12: 8,
        22: 9,
        23: 10,
        24: 11,
        25: 12,
        26: 13,
        27: 14,
        28: 15,
        30: 16,
        **dict.fromkeys((0, 1, 5, 7, 8, 10, 11, 13, 19, 20, 29, 31), NO_CLASS),
    }
)
"""Class id in the files of Occ3D for each of the 32 classes of nuScenes-lidarseg, `NO_CLASS` where there is none."""


class Occ3DNuScenes:
    """A source (`SceneSource`) of the key frames of nuScenes with the voxel labels of Occ3D.

    The test scenes are the 150 official validation scenes, on which results are published; the labels of the official
    test scenes are secret. Of the 700 training scenes every `val_every`-th is kept for validation.

    Args:
        root: folder with `v1.0-trainval` (tables), `samples` (images, LiDAR) and `gts` (labels); `lidarseg` is
            optional and gives classes of pixels and LiDAR rays.
        version: folder of the tables: v1.0-trainval or v1.0-mini.
        image_width: width of the images that the model gets, px; the height follows, a multiple of 8.
        panorama: width and height (px), upper and lower edge (deg) of the panoramas of ranges.
        ego_motion: whether the cameras are placed where the car was when each of them took its image; False: as
            mounted, so that all frames of a scene have equal rigs.
        val_every: n, of which every n-th training scene is for validation; at least 2.
        cache: folder for the index and the data derived from the labels; None: `omniocc` in root.

    Raises:
        ValueError: if a number is too small.
    """

    def __init__(
        self,
        root: str,
        version: Literal["v1.0-trainval", "v1.0-mini"],
        image_width: int,
        panorama: tuple[int, int, float, float],
        ego_motion: bool,
        val_every: int,
        cache: str | None,
    ):
        if image_width < 8 or val_every < 2:
            raise ValueError(f"image_width must be at least 8 and val_every 2, got {image_width} and {val_every}")
        self.root, self.version = root, version
        self.image_width = image_width
        self.panorama = Equirectangular(*panorama)
        self.ego_motion, self.val_every = ego_motion, val_every
        self.folder = Path(root, "omniocc") if cache is None else Path(cache)
        self.index = Index(self.folder / f"index-{version}", KeyFrames, self._read_tables)

    @property
    def spec(self) -> SourceSpec:
        """Return classes, bands and the protocol: rays see all voxels, cells count where a camera sees them."""
        return SourceSpec(CLASSES, (0.0, 20.0, 40.0), 0.5, -ORIGIN_M[2], None, Benchmark(GRID, masked_rays=False))

    @property
    def fingerprint(self) -> str:
        """Return a hash of the scenes, their splits, the sizes of images and panoramas, and `ego_motion`."""
        options = [self.image_width, repr(self.panorama), self.ego_motion, self.val_every]
        return digest([self.version, self.index.fingerprint, *options])

    def prepare(self) -> None:
        """Build the index from the tables if it is missing: once, some minutes for all of nuScenes.

        Raises:
            DataError: naming what is missing or wrong.
        """
        check_root(self.root, [self.version, "samples", "gts"], "unpack nuScenes and Occ3D's gts into it")
        self.index.prepare()

    def scenes(self, split: Split) -> Sequence["Occ3DScene"]:
        """Return the scenes of a split, in order of their names."""
        return [Occ3DScene(self, name) for name in self.split_names[split]]

    @cached_property
    def split_names(self) -> dict[Split, list[str]]:
        """Return the names of the scenes of every split."""
        training = [name for name in self.index.names if not is_validation(name)]
        val = training[self.val_every - 1 :: self.val_every]
        test = [name for name in self.index.names if is_validation(name)]
        return {"train": [name for name in training if name not in val], "val": val, "test": test}

    def labels(self, geometry: Grid, ignore: Ignore) -> OwnGridLabels:
        """Return the labels of Occ3D in a grid; `unobserved` and `unseen` use its masks of LiDAR and cameras."""
        return OwnGridLabels(self.folder, self.fingerprint, GRID, geometry, CLASSES.num_classes, ignore)

    def _read_tables(self) -> dict[str, KeyFrames]:
        return read_key_frames(Path(self.root, self.version))


class Occ3DScene(DatasetScene):
    """One scene of 20 s: about 40 key frames."""

    dataset = "Occ3D-nuScenes"

    def __init__(self, source: Occ3DNuScenes, name: str):
        super().__init__(name, source.panorama)
        self.root, self.version, self.index = Path(source.root), source.version, source.index
        self.image_width, self.ego_motion = source.image_width, source.ego_motion

    def __len__(self) -> int:
        return len(self.frames.tokens)

    @property
    def frames(self) -> KeyFrames:
        """Return the scene's part of the index."""
        return self.index.read(self.name)

    @cached_property
    def world_from_ego(self) -> np.ndarray:
        """Return the pose of every frame, (F, 4, 4), at the LiDAR's time."""
        return self.frames.world_from_ego @ shift(*ORIGIN_M)

    @cached_property
    def rigs(self) -> tuple[Rig, ...]:
        """Return the cameras of every frame; equal ones are one object."""
        poses = shift(*(-value for value in ORIGIN_M)) @ (
            self.frames.ego_from_camera if self.ego_motion else self.frames.mounted
        )
        rigs: dict[bytes, Rig] = {}
        for matrices, intrinsics, sizes in zip(poses, self.frames.intrinsics, self.frames.size, strict=True):
            key = matrices.tobytes() + intrinsics.tobytes()
            if key not in rigs:
                cameras = tuple(
                    _make_camera(k, size, self.image_width) for k, size in zip(intrinsics, sizes, strict=True)
                )
                rigs[key] = Rig(cameras, torch.from_numpy(matrices), CAMERAS, None, -ORIGIN_M[2])
        return tuple(
            rigs[matrices.tobytes() + intrinsics.tobytes()]
            for matrices, intrinsics in zip(poses, self.frames.intrinsics, strict=True)
        )

    def images(self, frame: int) -> list[np.ndarray]:
        """Return the six images, scaled."""
        files, sizes = self.frames.images[frame], self.frames.size[frame].tolist()
        with self.naming(frame):
            return [
                read_image(self.root / file, (width, height), (camera.width, camera.height))
                for file, (width, height), camera in zip(files, sizes, self.rigs[frame].cameras, strict=True)
            ]

    def cloud(self, frame: int) -> Cloud:
        """Return the points of LIDAR_TOP, with classes where nuScenes-lidarseg is there."""
        ego_from_lidar = shift(*(-value for value in ORIGIN_M)) @ self.frames.ego_from_lidar[frame]
        with self.naming(frame):
            points_m, came_back = read_scan(self.root / str(self.frames.lidar[frame]), 5)
            labels = self._read_point_labels(frame, came_back)
        points_m = transform_points(ego_from_lidar, points_m).astype(np.float32)
        kept = outside(points_m, *OWN_CAR_M)
        return Cloud(points_m[kept], None if labels is None else labels[kept], ego_from_lidar[:3, 3])

    def own_voxels(self, frame: int, ignore: Ignore) -> UInt8[Tensor, "X Y Z"]:
        """Return the class of every cell of Occ3D's grid."""
        arrays = self._read_labels(frame)
        labels = torch.from_numpy(arrays["semantics"])
        masks = {"none": None, "unobserved": "mask_lidar", "unseen": "mask_camera"}
        mask = masks[ignore]
        return labels if mask is None else labels.masked_fill(torch.from_numpy(arrays[mask] == 0), UNKNOWN)

    def benchmark(self, frame: int) -> BenchmarkFrame:
        """Return the labels, the camera mask, and the origins from which the public RayIoU casts its rays."""
        arrays = self._read_labels(frame)
        scored: Bool[Tensor, "X Y Z"] = torch.from_numpy(arrays["mask_camera"] != 0)
        labels = torch.from_numpy(arrays["semantics"])
        return BenchmarkFrame(labels, scored, self.ray_origins(frame))

    def ray_origins(self, frame: int) -> RayOrigins:
        """Return the positions (float32) of the LiDAR in the key frames around this one, at most eight."""
        frames = self.frames
        world_from_lidar = frames.world_from_ego @ frames.ego_from_lidar
        ego_from_world = inverse(frames.world_from_ego[frame])
        positions_m = torch.from_numpy(transform_points(ego_from_world, world_from_lidar[:, :3, 3]))
        chosen = origin_frames(positions_m)
        positions_m = positions_m[chosen] - torch.tensor(ORIGIN_M, dtype=torch.float64)
        return RayOrigins(positions_m.float(), chosen - frame)

    def label_file(self, frame: int) -> Path:
        """Return the file of a frame's labels."""
        return self.root / "gts" / self.name / str(self.frames.tokens[frame]) / "labels.npz"

    def prediction_file(self, frame: int) -> str:
        """Return the name of a frame's file in a submission, as the public script of RayIoU expects it."""
        return f"{self.frames.tokens[frame]}.npz"

    def write_prediction(self, path: Path, classes: UInt8[np.ndarray, "X Y Z"]) -> None:
        """Write our classes (0 free) as the array `pred` (17 free)."""
        content = io.BytesIO()
        np.savez_compressed(content, pred=encode_classes(classes))
        atomic_write(path, content.getvalue())

    def read_prediction(self, path: Path) -> UInt8[np.ndarray, "X Y Z"]:
        """Return our classes (0 free) from the array `pred` (17 free)."""
        return decode_classes(read_npz(path, {"pred": SHAPE})["pred"], path)

    def _read_labels(self, frame: int) -> dict[str, np.ndarray]:
        names, path = ("semantics", "mask_lidar", "mask_camera"), self.label_file(frame)
        with self.naming(frame):
            arrays = read_npz(path, dict.fromkeys(names, SHAPE), LABELS_REMEDY)
            return arrays | {"semantics": decode_classes(arrays["semantics"], path)}

    def _read_point_labels(self, frame: int, kept: Bool[np.ndarray, " R"]) -> np.ndarray | None:
        folder = self.root / "lidarseg" / self.version
        if not folder.is_dir():
            return None
        path = folder / f"{self.frames.lidar_tokens[frame]}_lidarseg.bin"
        file_ids = map_classes(read_array(path, "u1", kept.shape)[kept], FILE_ID_OF_LIDARSEG, path)
        return np.where(file_ids == NO_CLASS, UNKNOWN, file_ids + 1).astype(np.uint8)


def decode_classes(semantics: np.ndarray, path: Path = Path("labels.npz")) -> np.ndarray:
    """Return our classes (0 free) for class ids of a file (17 free); raise DataError for other ids, naming the file."""
    return map_classes(semantics, CLASS_OF_FILE_ID, path)


def encode_classes(classes: np.ndarray) -> np.ndarray:
    """Return the class ids of a file (17 free) for our classes (0 free)."""
    return np.where(classes == FREE, FREE_ID, classes - 1).astype(np.uint8)


def _make_camera(matrix: np.ndarray, size: np.ndarray, image_width: int) -> Camera:
    (width, height), k = size.tolist(), matrix
    camera = Pinhole(width, height, (float(k[0, 0]), float(k[1, 1])), (float(k[0, 2]), float(k[1, 2])))
    return camera.resized(*scaled_size(width, height, image_width))
