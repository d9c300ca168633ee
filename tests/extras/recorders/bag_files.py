"""Write a recorded scene as a bag of ROS 1 or 2: images, CameraInfo, points with classes, tf and odometry."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
from log_files import EGO_FROM_LIDAR, lidar_points, stamp_ns, table_of
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from scipy.spatial.transform import Rotation

from omniocc.data import SceneReader

EGO_FROM_BASE = np.array([[1.0, 0, 0, -1.5], [0, 1, 0, 0], [0, 0, 1, -2], [0, 0, 0, 1]])
"""The frame of the vehicle lies at the rear axle, 2 m below the cameras."""
BASE_OPTION = "ego_from_base={position_m: [-1.5, 0, -2], quaternion_wxyz: [1, 0, 0, 0]}"
MAP_FROM_ODOM = np.array([[0.0, -1, 0, 100], [1, 0, 0, 200], [0, 0, 1, 3], [0, 0, 0, 1]])


class BagWriter:
    """A bag of either kind; `write(topic, type, time, **fields)` adds a message."""

    def __init__(self, path: Path, ros: int, **storage: Any):
        self.ros, self.store = ros, get_typestore(Stores.ROS1_NOETIC if ros == 1 else Stores.ROS2_HUMBLE)
        if ros == 1:
            self.store.register(
                get_types_from_msg("geometry_msgs/TransformStamped[] transforms\n", "tf2_msgs/msg/TFMessage")
            )
        self.bag: Any = Writer1(path) if ros == 1 else Writer2(path, version=8, **storage)
        self.connections: dict[str, Any] = {}

    def __enter__(self) -> "BagWriter":
        self.bag.open()
        return self

    def __exit__(self, *_: object) -> None:
        self.bag.close()

    def make(self, kind: str, **fields: Any) -> Any:
        return self.store.types[kind](**fields)

    def header(self, stamp_ns: int, frame: str) -> Any:
        stamp = self.make("builtin_interfaces/msg/Time", sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
        more = {"seq": 0} if self.ros == 1 else {}
        return self.make("std_msgs/msg/Header", stamp=stamp, frame_id=frame, **more)

    def write(self, topic: str, kind: str, received_ns: int, **fields: Any) -> None:
        if topic not in self.connections:
            self.connections[topic] = self.connect(topic, kind)
        self.bag.write(self.connections[topic], received_ns, self.content(kind, fields))

    def connect(self, topic: str, kind: str) -> Any:
        return self.bag.add_connection(topic, kind, typestore=self.store)

    def content(self, kind: str, fields: dict[str, Any]) -> bytes:
        serialize = self.store.serialize_ros1 if self.ros == 1 else self.store.serialize_cdr
        return bytes(serialize(self.make(kind, **fields), kind))

    def transforms(self, topic: str, received_ns: int, poses: list[tuple[str, str, np.ndarray]]) -> None:
        stamped = []
        for parent, child, pose in poses:
            place, turn = self.vector("Vector3", pose), self.turn(pose)
            moved = self.make("geometry_msgs/msg/Transform", translation=place, rotation=turn)
            fields = {"header": self.header(received_ns, parent), "child_frame_id": child, "transform": moved}
            stamped.append(self.make("geometry_msgs/msg/TransformStamped", **fields))
        self.write(topic, "tf2_msgs/msg/TFMessage", received_ns, transforms=stamped)

    def vector(self, kind: str, pose: np.ndarray) -> Any:
        return self.make(f"geometry_msgs/msg/{kind}", **dict(zip("xyz", pose[:3, 3].tolist(), strict=True)))

    def turn(self, pose: np.ndarray) -> Any:
        quaternion = Rotation.from_matrix(pose[:3, :3]).as_quat().tolist()
        return self.make("geometry_msgs/msg/Quaternion", **dict(zip("xyzw", quaternion, strict=True)))


def write_bag(scene: SceneReader, path: Path, ros: int, writer: Any = BagWriter) -> Path:
    base_from_ego = np.linalg.inv(EGO_FROM_BASE)
    with writer(path, ros) as bag:
        first = stamp_ns(scene, 0)
        mounted = [("base_link", "lidar", base_from_ego @ EGO_FROM_LIDAR)]
        for name, pose in zip(scene.rig.names, scene.rig.ego_from_camera.numpy(), strict=True):
            mounted.append(("base_link", name, base_from_ego @ pose))
        bag.transforms("/tf_static", first, mounted)
        for frame in range(len(scene)):
            now = stamp_ns(scene, frame)
            world_from_base = scene.world_from_ego[frame] @ EGO_FROM_BASE
            odom_from_base = np.linalg.inv(MAP_FROM_ODOM) @ world_from_base
            bag.transforms("/tf", now, [("odom", "base_link", odom_from_base)])
            if frame == 0:
                bag.transforms("/tf", now, [("map", "odom", MAP_FROM_ODOM)])
            write_odometry(bag, now, world_from_base)
            for name, image in zip(scene.rig.names, scene.images(frame), strict=True):
                write_image(bag, name, now, image)
            write_points(bag, now, *lidar_points(scene, frame))
    return path


def write_odometry(bag: BagWriter, now: int, pose: np.ndarray) -> None:
    covariance = np.zeros(36)
    zero = bag.vector("Vector3", np.zeros((4, 4)))
    posed = bag.make("geometry_msgs/msg/Pose", position=bag.vector("Point", pose), orientation=bag.turn(pose))
    speed = bag.make("geometry_msgs/msg/Twist", linear=zero, angular=zero)
    fields = {
        "pose": bag.make("geometry_msgs/msg/PoseWithCovariance", pose=posed, covariance=covariance),
        "twist": bag.make("geometry_msgs/msg/TwistWithCovariance", twist=speed, covariance=covariance),
    }
    header = bag.header(now, "map")
    bag.write("/odometry", "nav_msgs/msg/Odometry", now, header=header, child_frame_id="base_link", **fields)


def write_image(bag: BagWriter, name: str, now: int, image: np.ndarray) -> None:
    """Write the camera `front` compressed, the others as bgr8 with four unused bytes after each row."""
    height, width = image.shape[:2]
    bgr = cv2.cvtColor(image, cv2.COLOR_RGB2BGR)
    if name == "front":
        content = cv2.imencode(".png", bgr)[1].reshape(-1)
        kind, fields = "sensor_msgs/msg/CompressedImage", {"format": "bgr8; png compressed", "data": content}
    else:
        rows = np.concatenate([bgr.reshape(height, -1), np.zeros((height, 4), np.uint8)], axis=1)
        kind, fields = "sensor_msgs/msg/Image", {"height": height, "width": width, "encoding": "bgr8"}
        fields |= {"is_bigendian": 0, "step": rows.shape[1], "data": rows.reshape(-1)}
    bag.write(f"/{name}/image", kind, now + 20_000_000, header=bag.header(now, name), **fields)


def write_points(bag: BagWriter, now: int, points: np.ndarray, labels: np.ndarray) -> None:
    table = table_of(points, labels)
    kinds = {"x": 7, "y": 7, "z": 7, "intensity": 7, "label": 4}
    fields = [
        bag.make("sensor_msgs/msg/PointField", name=name, offset=table.dtype.fields[name][1], datatype=kind, count=1)
        for name, kind in kinds.items()
    ]
    sizes = {"height": 1, "width": len(table), "point_step": table.itemsize, "row_step": table.nbytes}
    content = {"fields": fields, "is_bigendian": False, "is_dense": True}
    content |= sizes | {"data": np.frombuffer(table.tobytes(), np.uint8)}
    bag.write("/points", "sensor_msgs/msg/PointCloud2", now, header=bag.header(now, "lidar"), **content)


def write_info(bag: BagWriter, name: str, now: int, model: str, size: tuple[int, int], k: list, d: list) -> None:
    roi = bag.make("sensor_msgs/msg/RegionOfInterest", x_offset=0, y_offset=0, height=0, width=0, do_rectify=False)
    numbers = {"d": np.array(d, float), "k": np.array(k, float), "r": np.eye(3).ravel(), "p": np.zeros(12)}
    named = {key.upper() if bag.ros == 1 else key: value for key, value in numbers.items()}
    named |= {"width": size[0], "height": size[1], "distortion_model": model, "binning_x": 0, "binning_y": 0}
    header = bag.header(now, name)
    bag.write(f"/{name}/camera_info", "sensor_msgs/msg/CameraInfo", now, header=header, roi=roi, **named)
