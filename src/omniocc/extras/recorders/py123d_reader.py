"""A log of py123d in our terms: lenses, poses, scans and boxes.

In the library's logs poses are of the IMU, and points are in its frame. The ego frame has the axes of the rear axle's
frame (x forward, y left, z up) and its origin in the middle of the cameras.
"""

import zlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import msgpack
import numpy as np
import pyarrow
import torch
from jaxtyping import Bool, Float32, Float64, Int64, UInt8
from py123d.api.scene.arrow.arrow_scene_api import ArrowSceneAPI
from py123d.api.scene.arrow.modalities.sync_utils import get_modality_table
from py123d.datatypes import (
    BaseCameraMetadata,
    BoxDetectionSE3,
    DefaultLidarSegmentationLabel,
    FisheyeMEICameraMetadata,
    FThetaCameraMetadata,
    LidarID,
    LidarMetadata,
    PinholeCameraMetadata,
)
from py123d.geometry import PoseSE3

from omniocc.camera import MEI, Camera, FTheta, Pinhole, Rig
from omniocc.classes import OCCUPANCY_CLASSES, UNKNOWN, ClassTable, SemanticClass
from omniocc.data.formats.clouds import came_back
from omniocc.data.formats.dataset_scene import outside
from omniocc.data.formats.poses import inverse, quaternion_pose, shift, transform_points
from omniocc.data.source import Points
from omniocc.errors import DataError, UserError, in_line, reason_of
from omniocc.extras.recorders.log import ReadImage, Scan, Scans
from omniocc.extras.recorders.streams import MISSING, interpolate, nearest
from omniocc.frame import Box
from omniocc.io import check_regular

COLORS = (
    (255, 255, 255),  # free
    (0, 0, 142),
    (119, 11, 32),
    (220, 20, 60),
    (255, 0, 0),
    (128, 64, 128),
    (244, 35, 232),
    (152, 251, 152),
    (107, 142, 35),
    (70, 70, 70),
    (250, 170, 30),
    (190, 153, 153),
    (110, 110, 130),
)
CLASSES = ClassTable(
    tuple(
        SemanticClass(int(label), label.name.lower() if label.value else "free", rgb)
        for label, rgb in zip(DefaultLidarSegmentationLabel, COLORS, strict=True)
    )
)
"""The library's classes of points with its ids; 'ignore' is 255 with us, so that 0 is free."""
OF_BOX = {"TRAIN": "vehicle", "TRAFFIC_SIGN": "manmade", "TRAFFIC_LIGHT": "manmade"}
"""Classes of the library's boxes, by name, whose points are of a class with another name; unknown ones are 'other'."""
STAMPED_AT = {"kitti360": 0.5, "nuscenes": 1.0}
"""Where between the start (0) and the end (1) of a scan the time is to which a dataset gives its points and poses.

The library (0.7.0) takes the dataset's stamp for the start of a scan, but for KITTI-360 for its middle and for nuScenes
for its end.
"""
ANY, MERGED = "any", "lidar_merged"
LABEL_CLASS = "label_class"
"""End of the keys whose values name a class of Python, which the library imports."""


class Straight(NamedTuple):
    """How the image of a distorted pinhole becomes one without distortion.

    Attributes:
        maps: (2, H, W) column and row in the image of the file, px.
        seen: (H, W) which pixels the image of the file shows.
    """

    maps: Float32[np.ndarray, "2 H W"]
    seen: Bool[np.ndarray, "H W"]


class Py123dReader:
    """An open log.

    Args:
        folder: of the log.
        cameras: names by the library; None: all.

    Raises:
        UserError: if a camera is not in the log.
        DataError: naming the file that cannot be read, or the camera whose calibration makes no lens.
    """

    def __init__(self, folder: Path, cameras: Sequence[str] | None):
        self.folder = folder
        check_files(folder)
        with reading(str(folder)):
            self.scene = ArrowSceneAPI(folder)
            found = {view.camera_id.serialize(): view for view in self.scene.get_camera_metadatas().values()}
            self.car, log = self.scene.get_ego_state_se3_metadata(), self.scene.get_log_metadata()
        names = list(found) if cameras is None else list(cameras)
        if not names or not set(names) <= set(found):
            wrong = ", ".join(name for name in names if name not in found) or "none"
            raise UserError(f"cameras: {wrong}, but the log has {in_line(', '.join(found)) or 'none'}")
        if self.car is None:
            raise DataError(f"{folder}: it has no poses (ego_state_se3.arrow)")
        self.cameras: dict[str, BaseCameraMetadata] = {name: found[name] for name in names}
        with reading(str(folder)):
            imu_from_car = pose_of(self.car.rear_axle_to_imu_se3)
            imu_from_camera = np.stack([pose_of(view.camera_to_imu_se3) for view in self.cameras.values()])
            middle_m = (inverse(imu_from_car) @ imu_from_camera)[:, :3, 3].mean(0)
            self.ego_from_imu = inverse(imu_from_car @ shift(*middle_m))
            self.ego_from_camera = self.ego_from_imu @ imu_from_camera
            center_m = (self.ego_from_imu @ pose_of(self.car.center_to_imu_se3))[:3, 3]
        size_m = np.array([self.car.length, self.car.width, self.car.height])
        self.own_car_m = (center_m - size_m / 2).tolist(), (center_m + size_m / 2).tolist()
        self.facts = {"dataset": log.dataset, "log_name": log.log_name, "library": version("py123d")}
        self.files = [(path.name, path.stat().st_size) for path in sorted(folder.iterdir()) if path.is_file()]

    def views(self) -> tuple[Rig, tuple[Float64[np.ndarray, " S"], ...], ReadImage]:
        """Return the rig, the times of the images of each camera, s, and the function that reads an image.

        The road is at the lower end of the car's box; a log that puts it above the cameras states no road.
        """
        lenses: list[Camera] = []
        for name, view in self.cameras.items():
            with reading(f"{self.folder}: camera '{name}'"):
                lenses.append(camera_of(view))
        straight = [straightened(view) for view in self.cameras.values()]
        masks = [None if one is None or one.seen.all() else torch.from_numpy(one.seen) for one in straight]
        road_z_m = self.own_car_m[0][2]
        rig = Rig(
            tuple(lenses),
            torch.from_numpy(self.ego_from_camera),
            tuple(self.cameras),
            tuple(masks) if any(mask is not None for mask in masks) else None,
            road_z_m if road_z_m < 0 else None,
        )
        ids = [view.camera_id for view in self.cameras.values()]
        stamps = [self._stamps(f"camera '{name}'", "camera", name) for name in self.cameras]

        def read_image(camera: int, number: int) -> tuple[UInt8[np.ndarray, "height width 3"], str]:
            stamp_us, name = int(stamps[camera][number]), rig.names[camera]
            where = f"{self.folder}: camera '{name}' at {stamp_us} us"
            with reading(where):
                image = _there(self.scene.get_camera_at_timestamp(stamp_us, ids[camera])).rgb_image
            return straight_image(image, straight[camera], where), where

        return rig, tuple(times_us / 1e6 for times_us in stamps), read_image

    def poses(self) -> tuple[Float64[np.ndarray, " P"], Float64[np.ndarray, "P 4 4"]]:
        """Return the times, s, and world_from_ego."""
        stamps = self._stamps("the poses", "ego_state_se3", None)
        with reading(f"{self.folder}: the poses"):
            states = [_there(self.scene.get_ego_state_se3_at_timestamp(int(stamp_us))) for stamp_us in stamps]
            world_from_imu = np.stack([pose_of(state.imu_se3) for state in states])
        return stamps / 1e6, world_from_imu @ inverse(self.ego_from_imu)

    def scans(self, lidar: str, classes: bool, boxes: bool, limit_s: float) -> Scans:
        """Return the scans of a LiDAR without the points in the box of the own car.

        Args:
            lidar: name by the library, or `ANY`.
            classes: whether points have classes, if the log has them; scans without have unknown ones.
            boxes: whether scans have the boxes of actors, if the log has them; scans without boxes are left out.
            limit_s: longest time between a scan and its boxes, which are moved along by their velocity.

        Raises:
            UserError: naming the LiDARs that there are, or if no scan has boxes.
        """
        sensor, metadata = self._lidar(lidar)
        stamps, labels_of = self._stamps("the LiDAR", "lidar", sensor), classes_of_ids(metadata) if classes else None
        where = [f"{self.folder}: {sensor} at {stamp_us} us" for stamp_us in stamps]
        times_us = stamps + STAMPED_AT.get(self.facts["dataset"], 0.0) * self._span_us(sensor)

        def read(number: int) -> Scan:
            with reading(where[number]):
                scan = _there(self.scene.get_lidar_at_timestamp(int(stamps[number]), sensor))
                given, semantic = np.asarray(scan.xyz, np.float64), scan.semantic
            labels = np.full(len(given), UNKNOWN if labels_of is not None else OCCUPANCY_CLASSES.occupied[0], np.uint8)
            if labels_of is not None and semantic is not None:
                labels = labels_of[semantic]
            back = came_back(given)
            points_m = transform_points(self.ego_from_imu, given[back]).astype(np.float32)
            kept = outside(points_m, *self.own_car_m)
            return Scan(Points(points_m[kept], labels[back][kept]))

        position_m = (self.ego_from_imu @ pose_of(metadata[0].lidar_to_imu_se3))[:3, 3]
        table = OCCUPANCY_CLASSES if labels_of is None else CLASSES
        if not boxes or self.scene.get_box_detections_se3_metadata() is None:
            return Scans(times_us / 1e6, read, where.__getitem__, table, position_m)
        boxed = self._stamps("the boxes", "box_detections_se3", None)
        places = nearest(boxed / 1e6, times_us / 1e6, limit_s)
        kept = np.flatnonzero(places != MISSING)
        if not kept.size:
            raise UserError(f"boxes: none is within limit_s={limit_s:g} of a scan; boxes=false records without them")
        # scans of frames at the ends of the poses, see `log._motion`
        world_from_ego, _ = interpolate(*self.poses(), times_us / 1e6, 2 * limit_s)

        def read_boxes(number: int) -> tuple[Box, ...]:
            scan = int(kept[number])
            stamp_us = int(boxed[places[scan]])
            with reading(f"{self.folder}: boxes at {stamp_us} us"):
                found = _there(self.scene.get_box_detections_se3_at_timestamp(stamp_us)).box_detections
                late_s = float(times_us[scan] - stamp_us) / 1e6
                there = [box for box in found if box.attributes.default_label.name != "EGO"]
                return tuple(ego_box(box, late_s, inverse(world_from_ego[scan]), table) for box in there)

        return Scans(
            times_us[kept] / 1e6,
            lambda number: read(int(kept[number])),
            lambda number: where[kept[number]],
            table,
            position_m,
            read_boxes,
        )

    def _stamps(self, what: str, kind: str, sensor: str | None) -> Int64[np.ndarray, " S"]:
        """Return the times of a stream, us, increasing; raise DataError if there are none."""
        with reading(f"{self.folder}: {what}"):
            found = self.scene.get_all_modality_timestamps(kind, sensor)
        if not found:
            raise DataError(f"{self.folder}: {what} has no samples")
        return np.unique(np.array([stamp.time_us for stamp in found], np.int64))

    def _span_us(self, sensor: str) -> float:
        """Return the time that a scan takes, us."""
        with reading(f"{self.folder}: {sensor}"):
            table = _there(get_modality_table(self.folder, f"lidar.{sensor}"))
            start, end = (table[f"lidar.{sensor}.{name}timestamp_us"].to_numpy() for name in ("", "end_"))
            return float(np.median(end - start))

    def _lidar(self, lidar: str) -> tuple[str, list[LidarMetadata]]:
        """Return the name of a LiDAR, and what the log states of it, or of all that it merges, the upper one first."""
        with reading(str(self.folder)):
            found = [key.partition(".")[2] for key in self.scene.get_all_modality_metadatas() if key[:6] == "lidar."]
            metadata = self.scene.get_lidar_metadatas()
        sensor = MERGED if MERGED in found else found[0] if len(found) == 1 else None
        sensor = sensor if lidar == ANY else lidar if lidar in found else None
        if sensor is None:
            has = in_line(", ".join(found)) or "none: lidar=null records without points"
            raise UserError(f"lidar={lidar}: choose one of those that the log has: {has}")
        chosen = metadata.values() if sensor == MERGED else [metadata[LidarID.from_arbitrary(sensor)]]
        return sensor, sorted(chosen, key=lambda one: one.lidar_id != LidarID.LIDAR_TOP)


@contextmanager
def reading(where: str) -> Iterator[None]:
    """Turn whatever the library raises in this block into a DataError that begins with `where`."""
    try:
        yield
    except DataError:
        raise
    except Exception as error:  # of py123d, which asserts, and of what it reads with
        raise DataError(f"{where}: it cannot be read ({in_line(reason_of(error))})") from error


def check_files(folder: Path) -> None:
    """Check that the files of a log may be opened: no pipes, and no classes of labels but the library's own.

    Raises:
        DataError: naming the file; the library would import the module that such a name begins with.
    """
    for path in sorted(folder.glob("*.arrow")):
        check_regular(path)
        with reading(str(path)):
            with pyarrow.memory_map(str(path)) as source:
                stated = (pyarrow.ipc.open_file(source).schema.metadata or {}).get(b"metadata")
            names = label_classes(None if stated is None else msgpack.unpackb(stated, strict_map_key=False))
        for name in names:
            if not isinstance(name, str) or (not name.startswith("py123d.") and not name.isidentifier()):
                raise DataError(f"{path}: its labels are of the class {in_line(repr(name))}, which is none of py123d's")


def label_classes(content: Any) -> list[Any]:
    """Return all names of label classes in the metadata of a file, at any depth; those of its LiDARs are nested."""
    if not isinstance(content, Mapping):
        return []
    named = [value for key, value in content.items() if str(key).endswith(LABEL_CLASS) and value is not None]
    return named + [name for value in content.values() for name in label_classes(value)]


def pose_of(pose: PoseSE3) -> Float64[np.ndarray, "4 4"]:
    """Return a pose of the library as a matrix; raise ValueError if its numbers make none."""
    return quaternion_pose(pose.array[3:].tolist(), pose.array[:3].tolist(), "the pose")


def camera_of(view: BaseCameraMetadata) -> Camera:
    """Return the lens of a camera; of a distorted pinhole that of its straightened image.

    Raises:
        ValueError: if numbers are missing or make no lens, or the library has a lens that is not known here.
    """
    size = view.width, view.height
    if isinstance(view, PinholeCameraMetadata):
        fx, fy, cx, cy, skew = _there(view.intrinsics).array.tolist()
        if skew:
            raise ValueError(f"the skew is {skew}; it must be 0")
        return Pinhole(*size, (fx, fy), (cx, cy))
    if isinstance(view, FisheyeMEICameraMetadata):
        gamma1, gamma2, u0, v0 = _there(view.projection).array.tolist()
        distortion = (0.0,) * 4 if view.distortion is None else tuple(view.distortion.array.tolist())
        return MEI(*size, (gamma1, gamma2), (u0, v0), float(_there(view.mirror_parameter)), distortion, 180.0)
    if isinstance(view, FThetaCameraMetadata):
        stated = _there(view.intrinsics)
        radius_of_angle = tuple(np.trim_zeros(stated.fw_poly, "b").tolist())
        return FTheta(*size, (float(stated.cx), float(stated.cy)), radius_of_angle, (), (1.0, 0.0, 0.0), 180.0)
    raise ValueError(f"its lens is {type(view).__name__}; pinholes, MEI and f-theta are read")


def straightened(view: BaseCameraMetadata) -> Straight | None:
    """Return how images of a pinhole with distortion k1, k2, p1, p2, k3 (OpenCV) lose it; None for other cameras."""
    if not isinstance(view, PinholeCameraMetadata) or view.is_undistorted or view.distortion is None:
        return None
    if not view.distortion.array.any():
        return None
    matrix, size = _there(view.intrinsics).camera_matrix, (view.width, view.height)
    maps = np.stack(cv2.initUndistortRectifyMap(matrix, view.distortion.array, None, matrix, size, cv2.CV_32FC1))
    seen = (maps >= 0).all(0) & (maps[0] <= view.width - 1) & (maps[1] <= view.height - 1)
    return Straight(maps, seen)


def straight_image(
    image: UInt8[np.ndarray, "h w 3"], straight: Straight | None, where: str
) -> UInt8[np.ndarray, "h w 3"]:
    """Return an image without distortion; raise DataError if it is not of the size of its calibration."""
    if straight is None:
        return image
    if image.shape[:2] != straight.seen.shape:
        size, wanted = image.shape[1::-1], straight.seen.shape[::-1]
        raise DataError(f"{where}: the image has {size} px, its camera {wanted} px; convert the log again")
    return cv2.remap(image, straight.maps[0], straight.maps[1], cv2.INTER_LINEAR)


def classes_of_ids(metadata: Sequence[LidarMetadata]) -> UInt8[np.ndarray, " 256"] | None:
    """Return the class of every id of points in `CLASSES`, 255 unknown; None if no LiDAR states what ids mean."""
    known = [one.segmentation_label_class for one in metadata if one.segmentation_label_class is not None]
    if not known:
        return None
    table = np.full(256, UNKNOWN, np.uint8)
    for label in known[0]:
        table[int(label)] = int(label.to_default()) or UNKNOWN
    return table


def ego_box(box: BoxDetectionSE3, late_s: float, ego_from_world: Float64[np.ndarray, "4 4"], table: ClassTable) -> Box:
    """Return a box in the ego frame, `late_s` later, with the class of its points in a table of this module.

    A box without a velocity is taken to stand.
    """
    velocity_mps = np.zeros(3) if box.velocity_3d is None else box.velocity_3d.array
    pose, size = ego_from_world @ shift(*(late_s * velocity_mps)) @ pose_of(box.center_se3), box.bounding_box_se3
    name = box.attributes.default_label.name
    kind = OF_BOX.get(name, name.lower() if name.lower() in CLASSES.names else "other")
    return Box(
        id=zlib.crc32(box.attributes.track_token.encode()),
        label=table.names.index(kind) if table is CLASSES else OCCUPANCY_CLASSES.occupied[0],
        center_m=tuple(pose[:3, 3].tolist()),
        size_m=(float(size.length), float(size.width), float(size.height)),
        yaw_rad=float(np.arctan2(pose[1, 0], pose[0, 0])),
        velocity_mps=tuple((ego_from_world[:2, :3] @ velocity_mps).tolist()),
    )


def _there(found: Any) -> Any:
    """Return what the library has found; raise ValueError if it has found nothing."""
    if found is None:
        raise ValueError("the log has nothing there")
    return found
