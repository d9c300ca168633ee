"""Write a recorded scene as a log of py123d, by the library's own writer, so that the files have its form, not ours."""

import shutil
from pathlib import Path

import numpy as np
from py123d.api.scene.arrow.arrow_log_writer import ArrowLogWriter
from py123d.api.scene.arrow.utils.log_writer_config import LogWriterConfig
from py123d.datatypes import (
    BoxDetectionAttributes,
    BoxDetectionSE3,
    BoxDetectionsSE3,
    BoxDetectionsSE3Metadata,
    Camera,
    CameraID,
    DefaultBoxDetectionLabel,
    EgoStateSE3,
    EgoStateSE3Metadata,
    FisheyeMEICameraMetadata,
    FisheyeMEIDistortion,
    FisheyeMEIProjection,
    FThetaCameraMetadata,
    FThetaIntrinsics,
    Lidar,
    LidarFeature,
    LidarID,
    LidarMergedMetadata,
    LidarMetadata,
    LogMetadata,
    PinholeCameraMetadata,
    PinholeDistortion,
    PinholeIntrinsics,
    Timestamp,
)
from py123d.geometry import BoundingBoxSE3, PoseSE3, Vector3D
from py123d.parser.base_dataset_parser import ModalitiesSync
from py123d.parser.kitti360.kitti360_parser import Kitti360Parser
from py123d.parser.lidar_segmentation_registry import NuScenesLidarSegmentationLabel as Label

from omniocc.camera import MEI, FTheta
from omniocc.classes import WORLD_CLASSES
from omniocc.data import SceneReader
from omniocc.data.store.codec import decode_frame

START_US = 1_700_000_000_123_456
BOXES_US = -10_000
"""Boxes are this much later than the scan: earlier."""
SCANS_US = {"virtual": (0, 100_000), "kitti360": (-50_000, 50_000), "nuscenes": (-50_000, 0)}
"""Start and end of a scan around the time of its points, as the library's parsers of these datasets state them."""
IMU_FROM_EGO = np.array([[0.0, -1, 0, 0.5], [1, 0, 0, -0.25], [0, 0, 1, 0.75], [0, 0, 0, 1]])
"""The IMU is mounted with a quarter turn; the rear axle's frame has the axes of the car."""
REAR_AXLE_M = (-1.25, 0.0, -1.5)
LIDAR_M = (0.5, 0.0, 0.75)
CAR_M = (4.0, 1.75, 1.5)
"""Length, width and height of the car, whose box stands on the road."""
LABELS = {
    "Road": Label.DRIVEABLE_SURFACE,
    "Sidewalk": Label.SIDEWALK,
    "Ground": Label.TERRAIN,
    "Building": Label.MANMADE,
    "Wall": Label.MANMADE,
    "Vegetation": Label.VEGETATION,
    "Vehicle": Label.CAR,
    "Other": Label.NOISE,
    "Pole": Label.MANMADE,
    "Pedestrian": Label.PEDESTRIAN_ADULT,
    "Roadline": Label.DRIVEABLE_SURFACE,
}
"""nuScenes' labels of the points of the virtual world; the library ignores noise."""
BOXES = {"Vehicle": DefaultBoxDetectionLabel.VEHICLE, "Pedestrian": DefaultBoxDetectionLabel.PERSON}
IDS = {"front": CameraID.FMCAM_L, "left": CameraID.FTCAM_L0, "rear": CameraID.PCAM_B0, "right": CameraID.PCAM_R0}
RIG = """\
road_z_m: -2.0
cameras:
  front:
    {model: mei, width: 64, height: 36, focal_px: [30.0, 30.5], center_px: [31.25, 17.875], xi: 0.9,
     distortion: [-0.05, 0.01, 0.001, -0.002], max_angle_deg: 180,
     ego_from_camera: {position_m: [2.0, 0.0, 0.0], yaw_deg: 0, pitch_deg: -10, roll_deg: 0}}
  left:
    {model: ftheta, width: 64, height: 36, center_px: [31.75, 17.25], angle_to_pixeldist: [0, 15.0, -0.25, 0.1],
     pixeldist_to_angle: [], linear_cde: [1, 0, 0], max_angle_deg: 180,
     ego_from_camera: {position_m: [-0.5, 0.875, 0.0], yaw_deg: 90, pitch_deg: -10, roll_deg: 0}}
  rear:
    {model: mei, width: 64, height: 36, focal_px: [25.0, 25.0], center_px: [31.5, 17.5], xi: 0.0,
     distortion: [-0.1, 0.01, 0.001, -0.001], max_angle_deg: 180,
     ego_from_camera: {position_m: [-1.5, -0.5, 0.0], yaw_deg: 180, pitch_deg: -10, roll_deg: 0}}
  right:
    {model: pinhole, width: 64, height: 36, focal_px: [25.0, 25.0], center_px: [31.5, 17.5],
     ego_from_camera: {position_m: [0.0, -0.375, 0.0], yaw_deg: -90, pitch_deg: -10, roll_deg: 0}}
"""
"""The library's three lenses, and a pinhole with distortion; the middle of the cameras is the origin."""


def pose(matrix: np.ndarray) -> PoseSE3:
    return PoseSE3.from_transformation_matrix(np.asarray(matrix, np.float64))


def at(position_m: tuple[float, float, float]) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, 3] = position_m
    return matrix


def camera_metadata(name, camera, imu_from_camera):
    """Return the library's description of a camera: `MEI` with xi = 0 is a pinhole with distortion."""
    given = {"camera_name": name, "camera_id": IDS[name], "camera_to_imu_se3": pose(imu_from_camera)}
    given |= {"width": camera.width, "height": camera.height}
    if isinstance(camera, FTheta):
        forward = np.zeros(6)
        forward[: len(camera.angle_to_pixeldist)] = camera.angle_to_pixeldist
        backward = np.array([0, 1 / forward[1], 0, 0, 0, 0])  # the library only uses it for fields of view
        return FThetaCameraMetadata(intrinsics=FThetaIntrinsics(*camera.center_px, forward, backward), **given)
    if isinstance(camera, MEI) and camera.xi:
        distortion = FisheyeMEIDistortion(*camera.distortion)
        projection = FisheyeMEIProjection(*camera.focal_px, *camera.center_px)
        return FisheyeMEICameraMetadata(
            mirror_parameter=camera.xi, distortion=distortion, projection=projection, **given
        )
    distortion = PinholeDistortion(*camera.distortion, 0.0) if isinstance(camera, MEI) else None
    intrinsics = PinholeIntrinsics(*camera.focal_px, *camera.center_px)
    return PinholeCameraMetadata(
        intrinsics=intrinsics, distortion=distortion, is_undistorted=distortion is None, **given
    )


def lidar_metadata(labels=Label) -> LidarMergedMetadata:
    place = pose(IMU_FROM_EGO @ at(LIDAR_M))
    return LidarMergedMetadata({LidarID.LIDAR_TOP: LidarMetadata("top", LidarID.LIDAR_TOP, place, labels)})


def car_metadata(road_z_m: float) -> EgoStateSE3Metadata:
    center = IMU_FROM_EGO @ at((0.0, 0.0, road_z_m + CAR_M[2] / 2))
    length, width, height = CAR_M
    rear = IMU_FROM_EGO @ at(REAR_AXLE_M)
    return EgoStateSE3Metadata("virtual", width, length, height, 2.5, pose(center), pose(rear))


def stamp(scene: SceneReader, frame: int, late_us: int = 0) -> Timestamp:
    return Timestamp.from_us(START_US + round(scene.time_s[frame] * 1e6) + late_us)


def boxes_of(scene: SceneReader, frame: int) -> BoxDetectionsSE3:
    """Return the boxes of a frame in the world, where they were when their time stamp says."""
    world_from_ego, found = scene.world_from_ego[frame], []
    for box in frame_of(scene, frame).boxes:
        turn, velocity = np.eye(4), world_from_ego[:3, :3] @ np.array([*box.velocity_mps, 0.0])
        turn[:2, :2] = [[np.cos(box.yaw_rad), -np.sin(box.yaw_rad)], [np.sin(box.yaw_rad), np.cos(box.yaw_rad)]]
        turn[:3, 3] = box.center_m
        world_from_box = world_from_ego @ turn
        world_from_box[:3, 3] += velocity * BOXES_US / 1e6
        attributes = BoxDetectionAttributes(BOXES[WORLD_CLASSES.names[box.label]], str(box.id))
        found.append(
            BoxDetectionSE3(attributes, BoundingBoxSE3(pose(world_from_box), *box.size_m), Vector3D(*velocity))
        )
    return BoxDetectionsSE3(found, stamp(scene, frame, BOXES_US), BoxDetectionsSE3Metadata(DefaultBoxDetectionLabel))


def frame_of(scene: SceneReader, frame: int):
    return decode_frame(scene.read(frame, scene.index.members))


def write_py123d(scene: SceneReader, root: Path, labels=Label, dataset: str = "virtual") -> Path:
    """Write the whole scene as one log and return its folder."""
    config = LogWriterConfig(camera_store_option="png_binary", lidar_store_option="binary", lidar_codec="ipc_zstd")
    writer = ArrowLogWriter(config, root / "logs", root / "sensors")
    writer.reset(LogMetadata(dataset, f"{dataset}_train", "town", "town"))
    car, rig = car_metadata(scene.rig.road_z_m), scene.rig
    poses = IMU_FROM_EGO @ rig.ego_from_camera.numpy()
    views = [camera_metadata(*view) for view in zip(rig.names, rig.cameras, poses, strict=True)]
    ids = np.array([0, *(LABELS[name] for name in WORLD_CLASSES.names[1:])], np.uint8)
    for frame in range(len(scene)):
        now, world_from_imu = stamp(scene, frame), scene.world_from_ego[frame] @ np.linalg.inv(IMU_FROM_EGO)
        points = scene.points(frame)
        points_m = points.points_m @ IMU_FROM_EGO[:3, :3].T + IMU_FROM_EGO[:3, 3]
        features = {LidarFeature.SEMANTIC.serialize(): ids[points.labels]} if labels else None
        cameras = [
            Camera(view, image, pose(world_from_imu @ imu_from_camera), stamp(scene, frame, 1000 * k))
            for k, (view, image, imu_from_camera) in enumerate(zip(views, scene.images(frame), poses, strict=True))
        ]
        start, end = (stamp(scene, frame, late_us) for late_us in SCANS_US[dataset])
        scan = Lidar(start, end, lidar_metadata(labels), points_m.astype(np.float32), features)
        state = EgoStateSE3.from_imu(pose(world_from_imu), car, now)
        writer.write_sync(ModalitiesSync(now, [state, boxes_of(scene, frame), *cameras, scan]))
    writer.close()
    return root / "logs" / f"{dataset}_train" / "town"


def convert_kitti360(root: Path, place: Path) -> Path:
    """Convert a small KITTI-360 of our tests by the library's own parser, and return the folder of its first log."""
    (name,) = (path.name for path in (root / "data_2d_raw").iterdir())
    calibration, raw = root / "calibration" / "perspective.txt", root / "data_2d_raw" / name
    calibration.write_text(calibration.read_text() + "\nS_rect_01: 1408 376\n")
    streams = [raw / f"image_0{number}" for number in range(4)]
    numbers = sorted(path.stem for path in (streams[0] / "data_rect").iterdir())
    stamps = "".join(f"2013-05-28 08:46:02.{int(number):01d}00000000\n" for number in numbers)
    shutil.copytree(streams[0] / "data_rect", streams[1] / "data_rect")
    for folder in (*streams, root / "data_3d_raw" / name / "velodyne_points"):
        (folder / "timestamps.txt").write_text(stamps)
    boxes = root / "data_3d_bboxes" / "train" / f"{name}.xml"
    boxes.parent.mkdir(parents=True)
    boxes.write_text("<?xml version='1.0'?>\n<opencv_storage>\n</opencv_storage>\n")
    parser = Kitti360Parser(["kitti360_train"], root, place / "cache", 80.0, [name], [], [])
    (log,) = parser.get_log_parsers()
    config = LogWriterConfig(camera_store_option="png_binary", lidar_store_option="binary", lidar_codec="ipc_zstd")
    writer = ArrowLogWriter(config, place / "logs", place / "sensors")
    writer.reset(log.get_log_metadata())
    for modalities in log.iter_modalities_sync():
        writer.write_sync(modalities)
    writer.close()
    return place / "logs" / "kitti360_train" / name
