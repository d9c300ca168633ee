"""Public samples of real frames, read for `tools/real_world.py`. Calibrations of KITTI may lie in a folder beside.

nuScenes        a key frame in mmdetection3d's form: one .pkl of version 2, six images, *LIDAR_TOP*.bin, perhaps
                *_lidarseg.bin (https://github.com/open-mmlab/mmdetection3d, demo/data/nuscenes)
SemanticKITTI   sequences/<number> with image_2, perhaps image_3, velodyne, labels; calib.txt with its line Tr
KITTI-360       *_rgb.png and *_depth.png of image_02 (https://github.com/yuliangguo/depth_any_camera, demo/input)
surround view   front.png, right.png, back.png and left.png, taken with the built-in rig `surround_view`
                (https://github.com/neozhaoliang/surround-view-system-introduction): a cloth and twelve things
"""

import pickle
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple, cast

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float, Float64, UInt8
from torch import Tensor

from omniocc.camera import Camera, Equirectangular, Pinhole, Rig
from omniocc.classes import UNKNOWN, WORLD_CLASSES
from omniocc.data.formats import kitti
from omniocc.data.formats.clouds import read_scan
from omniocc.data.formats.files import decode, image_size, map_classes, read_array, read_image, read_text
from omniocc.data.formats.kitti360 import above_car, mounted, velodyne_pose
from omniocc.data.formats.nuscenes import CAMERAS
from omniocc.data.formats.poses import inverse, rigid, transform_points
from omniocc.data.source import completion, kitti360, occ3d_nuscenes
from omniocc.errors import FAULTS, DataError, UserError, reason_of
from omniocc.predict.input.images import find_frames, read_frame

NEAREST_M, BODY_M = 2.5, 0.5
"""Nearer points may be of the own car; points so high above the road are of things that stand on it."""
WORLD = {
    "Road": "Roadline road parking driveable_surface",
    "Sidewalk": "sidewalk",
    "Ground": "other-ground other_flat terrain",
    "Building": "building manmade",
    "Wall": "fence barrier",
    "Vegetation": "vegetation trunk",
    "Vehicle": "car bicycle motorcycle truck other-vehicle bus construction_vehicle trailer",
    "Pole": "pole traffic-sign",
    "Pedestrian": "person bicyclist motorcyclist pedestrian",
}
"""Classes of SemanticKITTI and nuScenes, and of checkpoints trained on them, by class of the virtual world."""
AS_WORLD = {name: name for name in WORLD_CLASSES.names if name not in ("Free", "Roadline")}
AS_WORLD |= {name: world for world, names in WORLD.items() for name in names.split()}
ARRAYS = {
    "numpy.ndarray",
    "numpy.dtype",
    "_codecs.encode",
    *(f"{core}.multiarray.{name}" for core in ("numpy.core", "numpy._core") for name in ("_reconstruct", "scalar")),
}
"""Names by which pickles of arrays and numbers of numpy are read."""
CLOTH_M, HOLE_M = ((-5.53, 4.45), (-3.0, 3.0)), ((-3.53, 2.49), (-1.3, 1.1))
"""Ends along x and y, in the rig's frame, of the cloth and of its hole, in which the car stands."""
PANORAMA = Equirectangular(192, 48, 45.0, -45.0)
"""Directions in which ranges on the cloth are compared."""
THINGS = {
    "right": ((628, 134), (547, 92), (244, 113), (680, 184)),
    "left": ((340, 124), (530, 88), (752, 156), (292, 165)),
    "front": ((361, 334), (790, 293), (90, 394)),
    "back": ((301, 199),),
}
"""Pixels (960 x 640) where cars, bushes and hedges meet the road, marked by hand, by camera."""


class RealFrame(NamedTuple):
    """A real frame, its origin in the middle of the cameras.

    Attributes:
        rig: with the height of the road.
        points_m: known points that a camera sees, (P, 3), in the frame of the rig.
        labels: their classes of the virtual world, 255 unknown; None: not known.
        lidar_m: where the LiDAR stands whose points these are; None: they are of a cloth and things on a flat road.
    """

    name: str
    rig: Rig
    images: Sequence[np.ndarray]
    points_m: Float64[Tensor, "P 3"]
    labels: UInt8[Tensor, " P"] | None = None
    lidar_m: Float64[Tensor, "3"] | None = None

    @property
    def road_z_m(self) -> float:
        """Return the height of the road."""
        return cast(float, self.rig.road_z_m)

    @property
    def standing(self) -> Bool[Tensor, " P"]:
        """Return which points are of things that stand on the road."""
        return self.points_m[:, 2] >= self.road_z_m + BODY_M - 1e-6  # feet of things lie on the road but for rounding


class PlainUnpickler(pickle.Unpickler):
    """Reads builtin types and arrays of numpy; whatever else a pickle names is refused."""

    def find_class(self, module: str, name: str) -> Any:
        """Return what arrays are made of."""
        if f"{module}.{name}" in ARRAYS:
            return super().find_class(module, name)
        raise pickle.UnpicklingError(f"it names {module}.{name}, which is not read")


@contextmanager
def naming(path: Path) -> Iterator[None]:
    """Turn what wrong content makes this block raise into a UserError that names the file or folder."""
    try:
        yield
    except (UserError, DataError):
        raise
    except (pickle.UnpicklingError, *FAULTS) as error:
        raise UserError(f"{path} is not as expected: {reason_of(error)}") from error


def only(folder: Path, pattern: str) -> Path:
    """Return the one file of a pattern; raise UserError if there is none or more than one."""
    found = sorted(folder.glob(pattern))
    if len(found) != 1:
        raise UserError(f"{folder} holds {len(found)} files {pattern}; one is needed")
    return found[0]


def as_world(names: Sequence[str], ids: np.ndarray) -> UInt8[Tensor, "..."]:
    """Return classes of the virtual world for ids of a table: 0, free, and 255 stay, and what has no class is Other."""
    table = np.full(256, UNKNOWN, np.uint8)
    table[: len(names)] = [WORLD_CLASSES.names.index(AS_WORLD.get(name, "Other")) for name in names]
    table[0] = 0
    return torch.from_numpy(table[ids])


def framed(
    name: str,
    cameras: Mapping[str, tuple[Camera, np.ndarray, np.ndarray]],
    scan: tuple[np.ndarray, Tensor | None, np.ndarray],
    road_z_m: float,
    masks: tuple[Tensor, ...] | None = None,
) -> RealFrame:
    """Return a frame from cameras with images and poses, points with classes and the LiDAR's place, all z up."""
    models, images, poses = zip(*cameras.values(), strict=True)
    ego_from_camera = torch.from_numpy(np.stack(poses))
    middle_m = ego_from_camera[:, :3, 3].mean(0)
    ego_from_camera[:, :3, 3] -= middle_m
    rig = Rig(models, ego_from_camera, tuple(cameras), masks, road_z_m - float(middle_m[2]))
    points_m, labels, lidar_m = torch.from_numpy(scan[0].astype(np.float64)) - middle_m, *scan[1:]
    seen = rig.project(points_m)[1].any(0) & (points_m.norm(dim=-1) > NEAREST_M)
    known = None if labels is None else labels[seen]
    return RealFrame(name, rig, images, points_m[seen], known, torch.from_numpy(lidar_m) - middle_m)


def pinhole_image(path: Path, k: np.ndarray) -> tuple[Pinhole, np.ndarray]:
    """Return an image, and its camera by the intrinsics, 3x3."""
    width, height = image_size(path)
    camera = Pinhole(width, height, (float(k[0, 0]), float(k[1, 1])), (float(k[0, 2]), float(k[1, 2])))
    return camera, read_image(path, None, (width, height))


def read_nuscenes(folder: Path) -> list[RealFrame]:
    """Return the key frame in a folder; the road is at the height 0 of its ego frame."""
    path, cameras = only(folder, "*.pkl"), {}
    with naming(path), path.open("rb") as file:
        info = PlainUnpickler(file).load()["data_list"][0]
        ego_from_lidar = rigid(np.array(info["lidar_points"]["lidar2ego"]), "lidar2ego")
        for name in CAMERAS:
            k, pose = (np.array(info["images"][name][key]) for key in ("cam2img", "lidar2cam"))
            pose = ego_from_lidar @ inverse(rigid(pose, name))
            cameras[name] = *pinhole_image(only(folder, f"*__{name}__*.jpg"), k), pose
    points_m, kept = read_scan(only(folder, "*LIDAR_TOP*.bin"), 5)
    labels = None
    for path in folder.glob("*_lidarseg.bin"):
        ids = map_classes(read_array(path, "u1", kept.shape)[kept], occ3d_nuscenes.FILE_ID_OF_LIDARSEG, path)
        ids = np.where(ids == occ3d_nuscenes.NO_CLASS, UNKNOWN, ids + 1)
        labels = as_world(occ3d_nuscenes.CLASSES.names, ids)
    scan = transform_points(ego_from_lidar, points_m), labels, ego_from_lidar[:3, 3]
    return [framed("nuScenes", cameras, scan, 0.0)]


def read_kitti(folder: Path) -> list[RealFrame]:
    """Return every frame with image_2 alone, and where there is image_3 with both; the frame is the velodyne's."""
    frames = []
    for left in sorted(folder.glob("sequences/*/image_2/*.png")):
        sequence = left.parents[1]
        files = [sequence / "calib.txt", *sorted(folder.parent.glob(f"*/sequences/{sequence.name}/calib.txt"))]
        whole = [file for file in files if file.is_file() and "Tr:" in read_text(file)]
        calibration = kitti.read_calibration((whole or files)[0])
        points_m, kept = read_scan(sequence / "velodyne" / f"{left.stem}.bin", 4)
        table = kitti.classes_by_id(kitti.SEMANTIC_KITTI_IDS)
        labels = kitti.read_point_classes(sequence / "labels" / f"{left.stem}.label", table, kept)
        scan = points_m, as_world(kitti.SEMANTIC_KITTI.names, labels), np.zeros(3)
        pair = [path for path in (left, sequence / "image_3" / left.name) if path.exists()]
        for files in (pair[: count + 1] for count in range(len(pair))):
            cameras = {}
            for path in files:
                k, pose = kitti.camera_of(calibration, int(path.parent.name[-1]))
                cameras[path.parent.name] = *pinhole_image(path, k), pose
            title = f"SemanticKITTI {sequence.name}/{left.stem}, {' and '.join(cameras)}"
            frames.append(framed(title, cameras, scan, completion.ROAD_Z_M))
    return frames


def read_kitti360(folder: Path) -> list[RealFrame]:
    """Return the image in a folder with the points of its pixels; the own car is masked."""
    file = "calibration/image_02.yaml"
    calibration = next((path.parent for path in [*folder.glob(file), *sorted(folder.parent.glob(f"*/{file}"))]), None)
    if calibration is None:
        raise UserError(f"{folder}: there is no {file} in it or in a folder beside it")
    camera, imu_from_camera = mounted(calibration, "image_02")
    image, path = only(folder, "*_rgb.png"), only(folder, "*_depth.png")
    depth = decode(path, cv2.IMREAD_UNCHANGED)
    if depth.dtype != np.uint16 or depth.shape != (camera.height, camera.width):
        raise UserError(f"{path} is {depth.dtype} {depth.shape}; it must be uint16 {camera.height, camera.width}")
    row, column = np.nonzero(depth)
    rays = camera.unproject(torch.from_numpy(np.stack([column, row], axis=-1)).double())[0].numpy()
    pose, lidar = (kitti360.ego_from_imu() @ one for one in (imu_from_camera, velodyne_pose(calibration)))
    scan = transform_points(pose, rays * depth[row, column, None] / 256), None, lidar[:3, 3]
    cameras = {"image_02": (camera, read_image(image, None, (camera.width, camera.height)), pose)}
    return [framed("KITTI-360", cameras, scan, kitti360.ROAD_Z_M, (above_car(camera),))]


def read_surround(folder: Path) -> list[RealFrame]:
    """Return the frame of the four images in a folder; its points lie on the cloth, and on things `BODY_M` up."""
    rig = Rig.load("surround_view")
    (frame,) = find_frames(str(folder), rig, [])
    down = PANORAMA.rays().double().flatten(0, 1)
    down = down[down[:, 2] < 0]
    road_m = down * (cast(float, rig.road_z_m) / down[:, 2:])
    points_m = torch.cat([road_m[on_cloth(road_m)], foot_points(rig) + torch.tensor([0.0, 0.0, BODY_M])])
    return [RealFrame("surround view", rig, read_frame(frame, rig), points_m)]


READERS = {
    "*LIDAR_TOP*.bin": read_nuscenes,
    "sequences/*/image_2/*.png": read_kitti,
    "*_depth.png": read_kitti360,
    "front.png": read_surround,
}
"""What lies in the folder of each kind of sample, and its reader."""


def read_folder(folder: Path) -> list[RealFrame]:
    """Return the frames in a folder; raise UserError or DataError, naming what is wrong or that its kind is unknown."""
    kinds = [read for pattern, read in READERS.items() if any(folder.glob(pattern))]
    if len(kinds) != 1:
        raise UserError(f"{folder} is of no known kind: files of exactly one kind must be there, {', '.join(READERS)}")
    with naming(folder):
        return kinds[0](folder)


def foot_points(rig: Rig) -> Float64[Tensor, "12 3"]:
    """Return where the things of the surround view stand, in the frame of the rig, m."""
    points = []
    for camera, pixel in ((rig.names.index(name), pixel) for name, pixels in THINGS.items() for pixel in pixels):
        ray = rig.cameras[camera].unproject(torch.tensor(pixel, dtype=torch.float64))[0]
        pose = rig.ego_from_camera[camera].double()
        away, center = pose[:3, :3] @ ray, pose[:3, 3]
        points.append(center + away * (cast(float, rig.road_z_m) - center[2]) / away[2])
    return torch.stack(points)


def on_cloth(points_m: Float[Tensor, "*P 3"]) -> Bool[Tensor, "*P"]:
    """Return whether points of the road are on the cloth."""

    def inside(ends: tuple[tuple[float, float], tuple[float, float]]) -> Tensor:
        (back, front), (right, left) = ends
        x, y = points_m[..., 0], points_m[..., 1]
        return (x > back) & (x < front) & (y > right) & (y < left)

    return inside(CLOTH_M) & ~inside(HOLE_M)
