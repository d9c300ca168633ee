"""QuadOcc as a source: one real annular camera on a quadruped robot, voxels around it.

Format: quad_lss_dataset.py, quad-ssc-remap.yaml, project_ocam.py and lidar2depth.py of
https://github.com/MasterHow/OccFormer. No real file of it has been read here.
"""

from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from jaxtyping import Bool, Float64, UInt8
from torch import Tensor

from omniocc.camera import Camera, Panoramic, Rig
from omniocc.camera.ops.pixels import pixel_centers
from omniocc.classes import UNKNOWN, ClassTable, SemanticClass
from omniocc.data.formats.clouds import read_cloud
from omniocc.data.formats.dataset_scene import Cloud
from omniocc.data.formats.files import check_root, map_classes, read_image, read_npy, scaled_size
from omniocc.data.formats.poses import inverse, rigid, transform_points
from omniocc.data.source import Benchmark, Ignore, SourceSpec, Split
from omniocc.data.source.own_grid import OwnGridScene, OwnGridSource, standing
from omniocc.errors import DataError
from omniocc.extras.datasets.ocam import read_ocam
from omniocc.geometry import Cuboid

SHAPE = (64, 64, 8)
GRID = Cuboid(SHAPE, (-12.8, 12.8), (-12.8, 12.8), (-1.2, 2.0))
"""The voxels in the frame of the LiDAR: x forward, y left, z up; cells of .4 m."""
NAMES = (
    ("empty", (255, 255, 255)),
    ("vehicle", (0, 0, 142)),
    ("person", (220, 20, 60)),
    ("road", (128, 64, 128)),
    ("building", (70, 70, 70)),
    ("vegetation", (107, 142, 35)),
    ("terrain", (152, 251, 152)),
)
CLASSES = ClassTable(tuple(SemanticClass(number, name, rgb) for number, (name, rgb) in enumerate(NAMES)))
IDS = {255: 0, 1: 1, 4: 2, 5: 3, 8: 4, 10: 5, 12: 6}
"""Class of the ids that count: in the files 255 is EMPTY, and 0 is occupied by something that has no label."""
TABLE = np.full(256, -1, dtype=np.int16)
TABLE[:15] = UNKNOWN  # the dataset's 15 ids, of which the other nine count for nothing
TABLE[list(IDS)] = list(IDS.values())
CAMERA_FROM_LIDAR = (
    (0.965595, 0.02617695, 0.25873031, 0.08),
    (-0.02528499, 0.99965732, -0.00677509, 0.0),
    (-0.258819, 0.0, 0.965926, -0.02),
)
"""From the LiDAR to the camera: x right and y down in the annular image, z along the optical axis, which points up."""
CAMERA_FROM_PANORAMA = ((-1.0, 0.0, 0.0, 0.0), (0.0, 0.0, -1.0, 0.0), (0.0, -1.0, 0.0, 0.0))
"""The middle of the unfolded image is what the annular one shows above its centre: to the right of the robot."""
TOP_DEG, BOTTOM_DEG = 50.0, -10.0
"""Elevations that the lens sees, against the plane across its axis."""
FILES = {"unfold": "images_unfold", "raw": "images_raw"}
CALIBRATION = "PAL_intrinsic_calib_results.txt"
INTERVAL_S = 0.5
"""Time between frames that are taken: not stated by the code."""


class QuadOcc(OwnGridSource["QuadOccScene"]):
    """A source (`SceneSource`) of QuadOcc; the ego frame is that of the voxels, in the place of the LiDAR.

    Args:
        root: folder with `sequences`, and for raw images `PAL_intrinsic_calib_results.txt`.
        sequences: folders of the sequences of train, val and test.
        images: unfold: panoramas, by the lens model `panoramic`; raw: annular images, by OCamCalib's.
        frame_step: every how many-th frame is taken.
        image_width: see `OwnGridSource`.
        panorama: see `OwnGridSource`.
        pitch_deg: angle by which the LiDAR looks down in the frame of the voxels. The authors' code takes 0, but its
            matrix has the LiDAR's forward axis 15 degrees below the plane of the camera.
        road_z_m: height of the ground below the LiDAR, m.
        cache: see `OwnGridSource`.

    Raises:
        ValueError: naming the argument that is impossible.
    """

    classes = CLASSES

    def __init__(
        self,
        root: str,
        sequences: Mapping[Split, Sequence[str]],
        images: Literal["unfold", "raw"],
        frame_step: int,
        image_width: int,
        panorama: tuple[int, int, float, float],
        pitch_deg: float,
        road_z_m: float,
        cache: str | None,
    ):
        super().__init__(root, sequences, image_width, panorama, cache)
        if images not in FILES or frame_step < 1:
            raise ValueError(f"images must be unfold or raw, and frame_step at least 1, got {images} and {frame_step}")
        self.images, self.frame_step, self.road_z_m = images, frame_step, road_z_m
        self.ego_from_lidar = looking_down(pitch_deg)

    @property
    def grid(self) -> Cuboid:
        """Return the voxels of the labels."""
        return GRID

    @property
    def spec(self) -> SourceSpec:
        """Return classes, bands and the protocol: all voxels count that are not unknown; nearer parts as well."""
        parts = tuple((f"{m}m", (-m, m), (-m, m)) for m in (3.2, 6.4))
        benchmark = Benchmark(GRID, parts=parts)
        return SourceSpec(CLASSES, (0.0, 3.2, 6.4, 12.8), INTERVAL_S, self.road_z_m, None, benchmark)

    def prepare(self) -> None:
        """Check the folders.

        Raises:
            DataError: naming what is missing or wrong.
        """
        needed = ["sequences"] if self.images == "unfold" else ["sequences", CALIBRATION]
        check_root(self.root, needed, "give the folder that holds QuadOcc's 'sequences'")
        check_root(
            str(Path(self.root, "sequences")), list(self.all_scenes), "unpack these sequences, or name others", ""
        )
        for scene in self.all_scenes.values():
            check_root(str(scene.folder), ["voxel_final", FILES[self.images]], "unpack the whole sequence", "")
            if not len(scene):
                raise DataError(f"{scene.folder}: there are no voxel_final/*.npy; unpack the sequence again")

    def sequence(self, name: str) -> "QuadOccScene":
        """Return a sequence by its folder."""
        return QuadOccScene(name, self)

    @cached_property
    def rig(self) -> Rig:
        """Return the camera, the same in every sequence."""
        ego_from_camera = self.ego_from_lidar @ inverse(rigid(np.array(CAMERA_FROM_LIDAR), "CAMERA_FROM_LIDAR"))
        if self.images == "unfold":
            camera: Camera = Panoramic(*scaled_size(6, 1, self.image_width), TOP_DEG, BOTTOM_DEG)
            pose, masks = ego_from_camera @ rigid(np.array(CAMERA_FROM_PANORAMA), "CAMERA_FROM_PANORAMA"), None
        else:
            camera, pose = read_ocam(Path(self.root, CALIBRATION), None, 90.0 - BOTTOM_DEG), ego_from_camera
            camera = camera.resized(*scaled_size(camera.width, camera.height, self.image_width))
            masks = (on_ring(camera),)
        return Rig((camera,), torch.from_numpy(pose)[None], (self.images,), masks, self.road_z_m)


class QuadOccScene(OwnGridScene):
    """Every `frame_step`-th frame of one sequence that has voxels. There are no poses: history can't be fused."""

    dataset = "QuadOcc"
    has_poses = False

    def __init__(self, name: str, source: QuadOcc):
        super().__init__(name, source.panorama)
        self.folder, self.source = Path(source.root, "sequences", name), source

    @property
    def rig(self) -> Rig:
        """Return the cameras, the same in every frame."""
        return self.source.rig

    @cached_property
    def numbers(self) -> list[str]:
        """Return the names of the files of the frames, in order."""
        return sorted(path.stem for path in (self.folder / "voxel_final").glob("*.npy"))[:: self.source.frame_step]

    @property
    def world_from_ego(self) -> np.ndarray:
        """Return the same pose for every frame."""
        return standing(len(self))

    def images(self, frame: int) -> list[np.ndarray]:
        """Return the image, scaled."""
        camera = self.rig.cameras[0]
        path = self.folder / FILES[self.source.images] / f"{self.numbers[frame]}.jpg"
        with self.naming(frame):
            return [read_image(path, None, (camera.width, camera.height))]

    def cloud(self, frame: int) -> Cloud | None:
        """Return the points of the LiDAR, whose classes are not known; None where the sequence has no scans."""
        if not (self.folder / "lidar").is_dir():
            return None
        with self.naming(frame):
            points_m = read_cloud(self.folder / "lidar" / f"{self.numbers[frame]}.pcd").points_m
        return Cloud(transform_points(self.source.ego_from_lidar, points_m).astype(np.float32), None, np.zeros(3))

    def own_voxels(self, frame: int, ignore: Ignore) -> UInt8[Tensor, "64 64 8"]:
        """Return the class of every cell, 255 where no label counts. There is no mask, so `ignore` changes nothing."""
        del ignore
        with self.naming(frame):
            path = self.folder / "voxel_final" / f"{self.numbers[frame]}.npy"
            return torch.from_numpy(map_classes(read_npy(path, SHAPE), TABLE, path))


def looking_down(pitch_deg: float) -> Float64[np.ndarray, "4 4"]:
    """Return `level_from_tilted` of a frame whose x axis points down by an angle."""
    cos, sin = np.cos(np.radians(pitch_deg)), np.sin(np.radians(pitch_deg))
    pose = np.eye(4)
    pose[0, [0, 2]], pose[2, [0, 2]] = (cos, sin), (-sin, cos)
    return pose


def on_ring(camera: Camera) -> Bool[Tensor, "height width"]:
    """Return the pixels of the annular image that show something: not those in its middle."""
    rays, _ = camera.unproject(pixel_centers(camera.width, camera.height, torch.float64))
    return rays[..., 2] <= np.sin(np.radians(TOP_DEG))
