"""Score checkpoints on real frames: `python tools/real_world.py FOLDER... --checkpoints any-rig tiny`.

The protocol and the figures are in `docs/real_frames.md`. Each FOLDER holds one of these samples; calibrations of KITTI
may lie in a folder beside it:

    nuScenes        a key frame in mmdetection3d's form: one .pkl of version 2, six images, *LIDAR_TOP*.bin, perhaps
                    *_lidarseg.bin (https://github.com/open-mmlab/mmdetection3d, demo/data/nuscenes)
    SemanticKITTI   sequences/<number> with image_2, perhaps image_3, velodyne, labels; calib.txt with its line Tr
    KITTI-360       *_rgb.png and *_depth.png of image_02 (https://github.com/yuliangguo/depth_any_camera, demo/input)
    surround view   front.png, right.png, back.png and left.png, taken with the built-in rig `surround_view`
                    (https://github.com/neozhaoliang/surround-view-system-introduction): a cloth and twelve things
"""

import argparse
import cmath
import json
import math
import pickle
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple, cast

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Complex128, Float, Float64, UInt8
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
from omniocc.geometry import Cuboid, Cylinder
from omniocc.io import atomic_write
from omniocc.model.protocols import learns
from omniocc.predict import Trained, load
from omniocc.predict.input.images import find_frames, read_frame, resized_to_width
from omniocc.predict.output.voxel_files import raise_grid
from omniocc.predict.predictor import predict_depth, seen_cells
from omniocc.runs.script import lines_not_tracebacks, quiet_libraries
from omniocc.runs.table import markdown, number
from omniocc.train import OccupancyTask
from rayiou import RayIoU, RayTruth, VoxelIoU

ALWAYS = "any-rig"
"""The checkpoint beside every other; its ranges are also scored without a network that decides on voxels."""
NEAREST_M, BODY_M = 2.5, 0.5
"""Nearer points may be of the own car; points so high above the road are of things that stand on it."""
EDGES_M = (0.0, 8.5, 17.0, 25.6)
BANDS = {f"{low:g}-{high:g} m": (low, high) for low, high in pairwise(EDGES_M)}
WITHIN_M = 2.0
WORLD = {
    "Free": "free empty",
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
OTHER = WORLD_CLASSES.names.index("Other")
ROAD, BUILDING = WORLD_CLASSES.names.index("Road"), WORLD_CLASSES.names.index("Building")
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
THING_M, THING_Z_M, TURNS_DEG = 0.9, (0.5, 2.2), range(10, 360, 10)
"""A thing is found where a cell so near to its foot point, so high above the road, is occupied; turns for chance."""
THINGS = {
    "right": ((628, 134), (547, 92), (244, 113), (680, 184)),
    "left": ((340, 124), (530, 88), (752, 156), (292, 165)),
    "front": ((361, 334), (790, 293), (90, 394)),
    "back": ((301, 199),),
}
"""Pixels (960 x 640) where cars, bushes and hedges meet the road, marked by hand, by camera."""
VOXEL_HEAD = ("RayIoU", "without classes", "road", "standing", *BANDS, "IoU")
CLOTH_HEAD = ("cloth occupied", "of it Road", "standing on it", "things", "by chance")
RANGE_HEAD = ("points", "with an answer", "within 10 %", "within 25 %", "median error")


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
    """Return classes of the virtual world for ids of a table with these names; 255 stays, what has none is Other."""
    ours = {name: name for name in WORLD_CLASSES.names}
    ours |= {name: world for world, others in WORLD.items() for name in others.split()}
    table = np.full(256, UNKNOWN, np.uint8)
    table[: len(names)] = [WORLD_CLASSES.names.index(ours.get(name, "Other")) for name in names]
    return torch.from_numpy(table[ids])


def framed(
    name: str,
    cameras: Mapping[str, tuple[Camera, np.ndarray]],
    images: Sequence[np.ndarray],
    scan: tuple[np.ndarray, Tensor | None, np.ndarray],
    road_z_m: float,
    masks: tuple[Tensor, ...] | None = None,
) -> RealFrame:
    """Return a frame from cameras with poses, and points, classes and place of the LiDAR, in one frame with z up."""
    models, poses = zip(*cameras.values(), strict=True)
    ego_from_camera = torch.from_numpy(np.stack(poses))
    middle_m = ego_from_camera[:, :3, 3].mean(0)
    ego_from_camera[:, :3, 3] -= middle_m
    rig = Rig(models, ego_from_camera, tuple(cameras), masks, road_z_m - float(middle_m[2]))
    points_m, labels, lidar_m = torch.from_numpy(scan[0].astype(np.float64)) - middle_m, *scan[1:]
    seen = rig.project(points_m)[1].any(0) & (points_m.norm(dim=-1) > NEAREST_M)
    known = None if labels is None else labels[seen]
    return RealFrame(name, rig, images, points_m[seen], known, torch.from_numpy(lidar_m) - middle_m)


def pinhole(k: np.ndarray, image: np.ndarray) -> Pinhole:
    """Return the camera of an image by its intrinsics, 3x3."""
    height, width = image.shape[:2]
    return Pinhole(width, height, (float(k[0, 0]), float(k[1, 1])), (float(k[0, 2]), float(k[1, 2])))


def read_nuscenes(folder: Path) -> list[RealFrame]:
    """Return the key frame in a folder; the road is at the height 0 of its ego frame."""
    path, cameras, images = only(folder, "*.pkl"), {}, []
    with naming(path), path.open("rb") as file:
        info = PlainUnpickler(file).load()["data_list"][0]
        ego_from_lidar = rigid(np.array(info["lidar_points"]["lidar2ego"]), "lidar2ego")
        for name in CAMERAS:
            images.append(read_image(image := only(folder, f"*__{name}__*.jpg"), None, image_size(image)))
            pose = ego_from_lidar @ inverse(rigid(np.array(info["images"][name]["lidar2cam"]), name))
            cameras[name] = pinhole(np.array(info["images"][name]["cam2img"]), images[-1]), pose
    points_m, kept = read_scan(only(folder, "*LIDAR_TOP*.bin"), 5)
    labels = None
    for path in folder.glob("*_lidarseg.bin"):
        ids = map_classes(read_array(path, "u1", kept.shape)[kept], occ3d_nuscenes.FILE_ID_OF_LIDARSEG, path)
        ids = np.where(ids == occ3d_nuscenes.NO_CLASS, UNKNOWN, ids + 1)
        labels = as_world(occ3d_nuscenes.CLASSES.names, ids)
    scan = transform_points(ego_from_lidar, points_m), labels, ego_from_lidar[:3, 3]
    return [framed("nuScenes", cameras, images, scan, 0.0)]


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
            images, cameras = [read_image(path, None, image_size(path)) for path in files], {}
            for path, image in zip(files, images, strict=True):
                k, pose = kitti.camera_of(calibration, int(path.parent.name[-1]))
                cameras[path.parent.name] = pinhole(k, image), pose
            title = f"SemanticKITTI {sequence.name}/{left.stem}, {' and '.join(cameras)}"
            frames.append(framed(title, cameras, images, scan, completion.ROAD_Z_M))
    return frames


def read_kitti360(folder: Path) -> list[RealFrame]:
    """Return the image in a folder with the points of its pixels; the own car is masked."""
    places = sorted(
        {folder, *folder.parent.glob("*/calibration/image_02.yaml"), *folder.glob("calibration/image_02.yaml")}
    )
    calibration = next((path.parent for path in places if path != folder), None)
    if calibration is None:
        raise UserError(f"{folder}: there is no calibration/image_02.yaml in it or in a folder beside it")
    camera, imu_from_camera = mounted(calibration, "image_02")
    image, path = only(folder, "*_rgb.png"), only(folder, "*_depth.png")
    depth = decode(path, cv2.IMREAD_UNCHANGED)
    if depth.dtype != np.uint16 or depth.shape != (camera.height, camera.width):
        raise UserError(f"{path} is {depth.dtype} {depth.shape}; it must be uint16 {camera.height, camera.width}")
    row, column = np.nonzero(depth)
    rays = camera.unproject(torch.from_numpy(np.stack([column, row], axis=-1)).double())[0].numpy()
    pose, lidar = (kitti360.ego_from_imu() @ one for one in (imu_from_camera, velodyne_pose(calibration)))
    scan = transform_points(pose, rays * depth[row, column, None] / 256), None, lidar[:3, 3]
    images = [read_image(image, None, (camera.width, camera.height))]
    cameras, masks = {"image_02": (camera, pose)}, (above_car(camera),)
    return [framed("KITTI-360", cameras, images, scan, kitti360.ROAD_Z_M, masks)]


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


def road_layer(grid: Cylinder | Cuboid, road_z_m: float) -> int:
    """Return the place along z of the cells that hold the road; below 0 or above the last where no cells do."""
    return math.floor((road_z_m - grid.height_m[0]) / grid.cell_m[2])


def ruled(occupied: Bool[Tensor, "X Y Z"], road: int) -> UInt8[Tensor, "X Y Z"]:
    """Return classes by height alone: Road up to the layer of the road, Building above."""
    by_height = torch.where(torch.arange(occupied.shape[2]) <= road, ROAD, BUILDING)
    return torch.where(occupied, by_height, 0).to(torch.uint8)


def ranges(trained: Trained, frame: RealFrame, rig: Rig) -> tuple[Float[Tensor, "h w"], Equirectangular]:
    """Return the ranges around a rig by the depth network of a checkpoint, nan without an answer, and its panorama."""
    batch, scaled = resized_to_width(frame.images, rig, trained.facts.width_for(rig))
    depth = predict_depth(trained.depth, batch, scaled, torch.device("cpu"))
    return depth.known_range_m()[0], cast(Equirectangular, trained.depth.panorama)


def range_cells(trained: Trained, frame: RealFrame, grid: Cylinder | Cuboid) -> UInt8[Tensor, "X Y Z"]:
    """Return the cells that the ranges end in, by `ruled`; the origin is as high above the road as in training."""
    rig, raised_m, _ = trained.facts.place(frame.rig)
    range_m, panorama = ranges(trained, frame, rig)
    known = range_m.isfinite()
    points_m = panorama.rays()[known] * range_m[known, None] + torch.tensor([0.0, 0.0, raised_m])
    occupied = grid.voxelize(points_m, torch.ones(len(points_m), dtype=torch.uint8), 2) > 0
    return ruled(occupied, road_layer(grid, frame.road_z_m))


def looked_up(range_m: Float[Tensor, "h w"], panorama: Equirectangular, points_m: Tensor) -> Float64[Tensor, " P"]:
    """Return the range in the direction of each point, nan where the panorama has none."""
    pixels, valid = panorama.project(points_m)
    column, row = pixels.round().long().unbind(-1)
    return range_m[row.clamp(0, panorama.height - 1), column % panorama.width].where(valid, torch.nan).double()


def range_scores(range_m: Float64[Tensor, " P"], frame: RealFrame) -> dict[str, list[float]]:
    """Return by kind of point: number, fractions answered, within 10 and 25 %, and the median relative error."""
    true_m = frame.points_m.norm(dim=-1)
    error = ((range_m - true_m) / true_m).abs()
    kinds = {"road": ~frame.standing, "standing": frame.standing}
    kinds |= {band: (true_m > low) & (true_m <= high) for band, (low, high) in BANDS.items()}
    scores = {}
    for kind, part in ((kind, error[chosen]) for kind, chosen in kinds.items() if bool(chosen.any())):
        fractions = [float(one.double().mean()) for one in (part.isfinite(), part < 0.1, part < 0.25)]
        scores[kind] = [len(part), *fractions, float(part.nanmedian())]
    return scores


def ray_scores(
    labels: UInt8[Tensor, "X Y Z"], grid: Cylinder | Cuboid, frame: RealFrame, seen: Bool[Tensor, "X Y Z"]
) -> dict[str, float]:
    """Return the scores of voxels (0 free) by the rays of the LiDAR; see `docs/real_frames.md`."""
    lidar_m = cast(Tensor, frame.lidar_m)
    near = (frame.points_m - lidar_m).norm(dim=-1) <= EDGES_M[-1]
    points_m, standing = frame.points_m[near], frame.standing[near]
    range_m = (points_m - lidar_m).norm(dim=-1)
    directions, starts = (points_m - lidar_m) / range_m[:, None], lidar_m.expand_as(points_m)
    occupied, hit = (labels > 0).to(torch.uint8), torch.ones(len(range_m), dtype=torch.uint8)

    def by_rays(volume: Tensor, truth: Tensor, classes: int = 2) -> RayIoU:
        metric = RayIoU(grid, classes, range_edges_m=EDGES_M)
        metric.update(volume[None], RayTruth(range_m[None], truth[None], directions[None], starts[None]))
        return metric

    def right(metric: RayIoU) -> Float64[Tensor, "2 bands"]:
        place = metric.counter.thresholds_m.index(WITHIN_M)
        return torch.stack([metric.correct[:, place, 1], metric.truth[:, 1]]).double()

    whole, scores = by_rays(occupied, hit), {}
    if frame.labels is not None:
        classes = by_rays(labels, frame.labels[near], WORLD_CLASSES.num_classes).compute()
        scores = {name: float(value) for name, value in classes.items() if name.startswith("rayiou/")}
        scores["RayIoU"] = float(classes["rayiou"])
    scores["without classes"] = float(whole.compute()["rayiou"])
    for kind, others in (("road", standing), ("standing", ~standing)):
        correct, count = right(by_rays(occupied, hit.masked_fill(others, UNKNOWN))).sum(1)
        scores[kind] = float(correct / count)
    correct, count = right(whole)
    scores |= dict(zip(BANDS, (correct / count).tolist(), strict=False)) | {"rays": int(count.sum())}
    paths = grid.paths(starts, directions)
    crossed = paths.cells[(paths.cells >= 0) & (paths.exit_m <= range_m[:, None])].long()
    target = grid.voxelize(points_m, hit, 2)
    observed = (target > 0) | torch.zeros(grid.num_cells).index_fill(0, crossed, 1.0).reshape(grid.shape).bool()
    metric = VoxelIoU(2)
    metric.update(occupied[None], target[None], (observed & seen)[None])
    return scores | {"IoU": float(metric.compute()["iou"])}


def things_found(cells: Complex128[Tensor, " C"], feet: Complex128[Tensor, " F"]) -> int:
    """Return how many foot points have the centre of one of these cells within `THING_M`; both are x + iy, m."""
    return int(((cells - feet[:, None]).abs() <= THING_M).any(1).sum())


def cloth_scores(
    labels: UInt8[Tensor, "X Y Z"], grid: Cylinder | Cuboid, frame: RealFrame, seen: Bool[Tensor, "X Y Z"]
) -> dict[str, float]:
    """Return the scores of voxels (0 free) by cloth and things; see `docs/real_frames.md`."""
    centers, road = grid.centers(torch.float64), road_layer(grid, frame.road_z_m)
    columns = labels[on_cloth(centers[:, :, road]) & seen[:, :, road]]
    covered = columns[:, road] > 0
    high_m = (centers[..., 2] - frame.road_z_m).round(decimals=6)
    body = (labels > 0) & (high_m >= THING_Z_M[0]) & (high_m <= THING_Z_M[1])
    cells, feet = (torch.complex(xyz[:, 0], xyz[:, 1]) for xyz in (centers[body], foot_points(frame.rig)))
    chance = [things_found(cells, feet * cmath.rect(1, math.radians(angle))) for angle in TURNS_DEG]
    return {
        "cloth occupied": float(covered.double().mean()),
        "of it Road": float((columns[covered, road] == ROAD).double().mean()),
        "standing on it": float((columns[:, road + 1 :] > 0).any(1).double().mean()),
        "things": things_found(cells, feet),
        "by chance": sum(chance) / len(chance),
    }


def voxel_rows(frame: RealFrame, checkpoints: Mapping[str, Trained], geometry: Any) -> dict[str, dict[str, float]]:
    """Return the scores of the checkpoints whose grid is `geometry`, and of what stands beside them, by row."""
    voxels = {name: one for name, one in checkpoints.items() if one.stage == OccupancyTask.STAGE}
    mine = {name: one for name, one in voxels.items() if one.occupancy.geometry == geometry}
    grid = raise_grid(geometry, next(iter(mine.values())).facts.place(frame.rig)[1])
    assert isinstance(grid, Cylinder | Cuboid)
    eye, road = torch.eye(4, dtype=torch.float64), road_layer(grid, frame.road_z_m)
    seen = seen_cells(grid, [(frame.rig, eye)], eye)
    rows = {"a flat road": ruled((torch.arange(grid.shape[2]) == road).expand(grid.shape), road)}
    for name, one in checkpoints.items():
        if name == ALWAYS or name not in voxels:
            rows[f"ranges of {name} as cells"] = range_cells(one, frame, grid)
    for name, one in mine.items():
        found = one.predict(frame.images, frame.rig)
        rows[name] = as_world(found.names, found.labels)
    if frame.lidar_m is not None:
        labels = torch.full((len(frame.points_m),), OTHER, dtype=torch.uint8) if frame.labels is None else frame.labels
        rows["true voxels"] = grid.voxelize(frame.points_m, labels)
    score = cloth_scores if frame.lidar_m is None else ray_scores
    kept = {name: labels.masked_fill(~seen | (labels == UNKNOWN), 0) for name, labels in rows.items()}
    return {name: score(labels, grid, frame, seen) for name, labels in kept.items()}


def range_rows(frame: RealFrame, checkpoints: Mapping[str, Trained]) -> dict[str, dict[str, list[float]]]:
    """Return the scores of a flat road and of the depth networks, told the height of the road and not, by row."""
    down = frame.points_m[:, 2]
    flat_m = frame.points_m.norm(dim=-1) * frame.road_z_m / down.where(down < 0, torch.nan)
    rows = {"a flat road": range_scores(flat_m, frame)}
    for name, one in checkpoints.items():
        if one.stage == OccupancyTask.STAGE and not learns(type(one.occupancy.sketch)):
            continue  # it has no ranges
        told = {name: frame.rig}
        if getattr(one.depth, "hints", False):
            told[f"{name}, not told the height"] = replace(frame.rig, road_z_m=None)
        for row, rig in told.items():
            rows[row] = range_scores(looked_up(*ranges(one, frame, rig), frame.points_m), frame)
    return rows


def voxel_table(rows: Mapping[str, Mapping[str, float]]) -> str:
    """Return a table of the scores of voxels."""
    head = CLOTH_HEAD if "things" in next(iter(rows.values())) else VOXEL_HEAD
    cells = [
        [name, *(f"{s[key]:.3g}" if s.get(key, 0) > 1 else number(s.get(key)) for key in head)]
        for name, s in rows.items()
    ]
    return markdown(["voxels", *head], cells)


def range_table(rows: Mapping[str, Mapping[str, list[float]]]) -> str:
    """Return a table of the scores of ranges."""
    cells = [
        [name, kind, str(count), *(f"{value:.0%}" for value in values)]
        for name, kinds in rows.items()
        for kind, (count, *values) in kinds.items()
    ]
    return markdown(["ranges", "of", *RANGE_HEAD], cells)


@lines_not_tracebacks
def main(words: list[str] | None = None) -> None:
    """Print tables for every frame in the folders, each frame alone."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", nargs="+", type=Path, help="of samples")
    parser.add_argument("--checkpoints", nargs="+", default=[], help="files, or names of weights in the package")
    parser.add_argument("--write", type=Path, metavar="FILE.json", help="keep the figures")
    given = parser.parse_args(words)
    quiet_libraries()
    frames, figures = [frame for folder in given.folders for frame in read_folder(folder)], {}
    checkpoints = {name: load(name) for name in dict.fromkeys([ALWAYS, *given.checkpoints])}
    grids = dict.fromkeys(one.occupancy.geometry for one in checkpoints.values() if one.stage == OccupancyTask.STAGE)
    for frame in frames:
        voxels, depths = [voxel_rows(frame, checkpoints, grid) for grid in grids], range_rows(frame, checkpoints)
        figures[frame.name] = {"voxels": voxels, "ranges": depths}
        print("\n".join([f"### {frame.name}\n", *map(voxel_table, voxels), range_table(depths)]), flush=True)
    if given.write:
        atomic_write(given.write, json.dumps(figures, indent=1) + "\n")


if __name__ == "__main__":
    torch.set_grad_enabled(False)
    main()
