"""H3O (Human360Occ) as a source: one panorama at the height of a head in CARLA's towns, voxels around it.

Format: h3o_lss_dataset.py, lidar2depth.py and h3o-remap-v4.yaml of https://github.com/MasterHow/OccFormer. No real
file of it has been read here.
"""

import re
from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from jaxtyping import Float32, UInt8
from torch import Tensor

from omniocc.camera import Equirectangular, Panoramic, Rig
from omniocc.camera.pose import pose_from_angles
from omniocc.classes import ClassTable, SemanticClass
from omniocc.data.formats.files import check_root, load_npy, map_classes, read_image, read_npy, read_text, scaled_size
from omniocc.data.source import SPLITS, Benchmark, Ignore, SourceSpec, Split
from omniocc.data.source.own_grid import OwnGridScene, OwnGridSource, mirrored, standing
from omniocc.errors import FAULTS, DataError
from omniocc.geometry import Cuboid
from omniocc.io import parse_json, twice

NAMES = (
    ("empty", (255, 255, 255)),
    ("road", (128, 64, 128)),
    ("sidewalk", (244, 35, 232)),
    ("building", (70, 70, 70)),
    ("vegetation", (107, 142, 35)),
    ("car", (0, 0, 142)),
    ("truck", (0, 0, 70)),
    ("bus", (0, 60, 100)),
    ("two_wheeler", (119, 11, 32)),
    ("person", (220, 20, 60)),
    ("pole", (153, 153, 153)),
)
CLASSES = ClassTable(tuple(SemanticClass(number, name, rgb) for number, (name, rgb) in enumerate(NAMES)))
TAGS = {
    1: (1, 24),
    2: (2,),
    3: (3, 4, 5),
    4: (9, 10),
    5: (14,),
    6: (15,),
    7: (16,),
    8: (18, 19),
    9: (12, 13),
    10: (6, 7, 8),
}
"""Tags of CARLA 0.9.14 and later of each class."""
TABLE = np.zeros(256, dtype=np.int16)
"""Class of each tag: all that are not listed become empty, also ground (25), static things (20) and water (23)."""
for _class, _tags in TAGS.items():
    TABLE[list(_tags)] = _class
FOLDERS = {0.4: ("occupancy_gt", (64, 64, 8)), 0.2: ("occupancy_gt_128x128x16", (128, 128, 16))}
"""Folder and cells of the voxels, by the size of a cell, m."""
FAR_M = 999.0
"""Planar depth from which there is nothing but sky: CARLA's cameras end at 1000 m."""
INTERVAL_S = 0.1
"""Time between frames: not stated by the code."""


class H3O(OwnGridSource["H3OScene"]):
    """A source (`SceneSource`) of H3O; the ego frame is that of the camera, in the middle of the voxels.

    Args:
        root: folder with `splits_homo.json`, `splits_heter.json` and the sequences that they name.
        places: homo: validation in the cities of training; heter: in other cities.
        splits: names in the file of the splits for train, val and test.
        cell_m: of the voxels: .4 or .2.
        y: direction of the second axis of the voxels in the files. The code's formula puts what is on the right of the
            image at positive y (right), its comment says left.
        image_width: see `OwnGridSource`.
        panorama: see `OwnGridSource`.
        road_z_m: height of the road below the camera, m.
        cache: see `OwnGridSource`.

    Raises:
        ValueError: naming the argument that is impossible.
    """

    classes = CLASSES

    def __init__(
        self,
        root: str,
        places: Literal["homo", "heter"],
        splits: Mapping[Split, str],
        cell_m: float,
        y: Literal["right", "left"],
        image_width: int,
        panorama: tuple[int, int, float, float],
        road_z_m: float,
        cache: str | None,
    ):
        super().__init__(root, dict.fromkeys(SPLITS, ()), image_width, panorama, cache)
        if places not in ("homo", "heter") or y not in ("right", "left") or cell_m not in FOLDERS:
            given = f"{places}, {y} and {cell_m}"
            raise ValueError(f"places must be homo or heter, y right or left, and cell_m .4 or .2, got {given}")
        if set(splits) != set(SPLITS):
            raise ValueError(f"splits need {', '.join(SPLITS)}, got {dict(splits)}")
        self.places, self.splits, self.y, self.road_z_m = places, splits, y, road_z_m
        self.voxels, self.shape = FOLDERS[cell_m]

    @property
    def grid(self) -> Cuboid:
        """Return the voxels of the labels."""
        return Cuboid(self.shape, (-12.8, 12.8), (-12.8, 12.8), (-2.4, 0.8))

    @property
    def spec(self) -> SourceSpec:
        """Return classes, bands and the protocol: all voxels count, there is no mask."""
        return SourceSpec(CLASSES, (0.0, 3.2, 6.4, 12.8), INTERVAL_S, self.road_z_m, None, Benchmark(self.grid))

    @property
    def options(self) -> list[object]:
        """Return what else the labels depend on."""
        return [self.places, self.voxels, self.y]

    def prepare(self) -> None:
        """Check the folders and the file of splits.

        Raises:
            DataError: naming what is missing or wrong.
        """
        check_root(self.root, [self.file.name], "give the folder that holds H3O's sequences and files of splits")
        folders = list(dict.fromkeys(name for split in SPLITS for name in self.listed[self.splits[split]]))
        check_root(self.root, folders, f"unpack the sequences that {self.file.name} names")
        for scene in self.all_scenes.values():
            if not len(scene):
                raise DataError(f"{scene.folder}: there are no {self.voxels}/*.npy; unpack the sequence again")

    def names(self, split: Split) -> Sequence[str]:
        """Return the folders of the sequences of a split; raise DataError if one stands there twice."""
        folders = self.listed[self.splits[split]]
        if (folder := twice(folders)) is not None:
            raise DataError(f"{self.file}: the folder '{folder}' stands twice in {self.splits[split]}; keep one")
        return folders

    @property
    def file(self) -> Path:
        """Return the file of splits."""
        return Path(self.root, f"splits_{self.places}.json")

    @cached_property
    def listed(self) -> dict[str, list[str]]:
        """Return the folders of each split of the file."""
        try:
            content = parse_json(read_text(self.file, "give H3O's own folder in data.source.root"))
            listed = {str(name): [str(folder) for folder in folders] for name, folders in content.items()}
        except FAULTS as error:
            raise DataError(f"{self.file}: it must hold lists of folders by split ({error})") from error
        missing = sorted(set(self.splits.values()) - set(listed))
        if missing:
            raise DataError(
                f"{self.file}: no split {', '.join(missing)}, only {', '.join(listed)}; set data.source.splits"
            )
        return listed

    def sequence(self, name: str) -> "H3OScene":
        """Return a sequence by its folder."""
        return H3OScene(name, self)

    @cached_property
    def rig(self) -> Rig:
        """Return the panoramic camera, the same in every sequence."""
        camera = Panoramic(*scaled_size(2, 1, self.image_width), 90.0, -90.0)
        pose = pose_from_angles((0.0, 0.0, 0.0), 0.0, 0.0, 0.0)[None]
        return Rig((camera,), pose, ("panorama",), None, self.road_z_m)


class H3OScene(OwnGridScene):
    """The frames of one sequence that have voxels. There are no poses: history can't be fused."""

    dataset = "H3O"
    has_poses = False

    def __init__(self, name: str, source: H3O):
        super().__init__(name.replace("/", "-"), source.panorama)
        self.folder, self.source = Path(source.root, name), source

    @property
    def rig(self) -> Rig:
        """Return the cameras, the same in every frame."""
        return self.source.rig

    @cached_property
    def numbers(self) -> list[str]:
        """Return the numbers of the frames, as in the names of the files."""
        files = (self.folder / self.source.voxels).glob("*.npy")
        return sorted(path.stem for path in files if re.fullmatch(r"\d{6}", path.stem))

    @property
    def world_from_ego(self) -> np.ndarray:
        """Return the same pose for every frame."""
        return standing(len(self))

    def images(self, frame: int) -> list[np.ndarray]:
        """Return the panorama, scaled."""
        camera = self.rig.cameras[0]
        with self.naming(frame):
            path = self.folder / "panorama_rgb" / f"{self.numbers[frame]}.png"
            return [read_image(path, None, (camera.width, camera.height))]

    def camera_range_m(self, frame: int) -> list[np.ndarray] | None:
        """Return the range of every pixel; None where the sequence has no depth."""
        camera = self.rig.cameras[0]
        found = self._range_m(frame, Equirectangular(camera.width, camera.height, 90.0, -90.0))
        return None if found is None else [found]

    def erp_range_m(self, frame: int) -> np.ndarray | None:
        """Return the panorama of ranges; None where the sequence has no depth."""
        return self._range_m(frame, self.panorama)

    def own_voxels(self, frame: int, ignore: Ignore) -> UInt8[Tensor, "X Y Z"]:
        """Return the class of every cell. There is no mask, so `ignore` changes nothing."""
        del ignore
        with self.naming(frame):
            path = self.folder / self.source.voxels / f"{self.numbers[frame]}.npy"
            classes = map_classes(read_npy(path, self.source.shape), TABLE, path)
        return torch.from_numpy(mirrored(classes) if self.source.y == "right" else classes)

    def _range_m(self, frame: int, wanted: Equirectangular) -> Float32[np.ndarray, "h w"] | None:
        """Return the ranges of the file at the nearest pixels of another panorama."""
        folder = self.folder / "panorama_depth_m"
        if not folder.is_dir():
            return None
        with self.naming(frame):
            range_m = read_range(folder / f"{self.numbers[frame]}.npy")
        height, width = range_m.shape
        # nearest: the mean of two ranges beside an edge is on neither surface
        pixels, _ = Equirectangular(width, height, 90.0, -90.0).project(wanted.rays())
        columns, rows = pixels.round().long().unbind(-1)
        return range_m[rows.clamp(0, height - 1).numpy(), columns.clamp(0, width - 1).numpy()]


def read_range(path: Path) -> Float32[np.ndarray, "h w"]:
    """Return the ranges (m) of a file of depth over the whole sphere; inf for the sky.

    Raises:
        DataError: if the file is missing, damaged or no image of depth.
    """
    depth_m = load_npy(path)
    if depth_m.ndim != 2 or not depth_m.size or depth_m.dtype.kind != "f":
        raise DataError(f"{path}: an array of {depth_m.dtype} and shape {depth_m.shape} is no image of depth in metres")
    return range_of_cube_depth(depth_m.astype(np.float32))


def range_of_cube_depth(depth_m: Float32[np.ndarray, "h w"]) -> Float32[np.ndarray, "h w"]:
    """Return the range (m) of depth along the axis of that face of a cube which a pixel of a panorama is seen in.

    Depth is planar, as CARLA's cameras measure it; on the unit ray n of the pixel the range is depth / max(|n|). Depth
    that is not above 0 is none: nan.
    """
    height, width = depth_m.shape
    rays = Equirectangular(width, height, 90.0, -90.0).rays().numpy()
    range_m = depth_m / np.abs(rays).max(axis=-1)
    return np.where(depth_m >= FAR_M, np.inf, np.where(depth_m > 0, range_m, np.nan)).astype(np.float32)
