"""Logs as ROS bags, of ROS 1 and 2, read by the package rosbags (extra `bag`) without an installation of ROS."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from jaxtyping import Float64, UInt8

from omniocc.camera import Rig
from omniocc.data.formats.clouds import RawCloud
from omniocc.data.formats.poses import inverse
from omniocc.errors import DataError, UserError, in_line, installing
from omniocc.extras.recorders.files import lidar_options, plain_options, scans_of, stated_depth
from omniocc.extras.recorders.labels import read_point_classes
from omniocc.extras.recorders.log import Log, ReadImage, Scans, Timing, chosen_rig
from omniocc.extras.recorders.log_scene import LogRecorder, SceneOptions
from omniocc.extras.recorders.messages import (
    FrameTree,
    camera_of,
    cloud_of,
    image_of,
    pose_of,
    stamp_ns,
    stamp_s,
    timed,
)
from omniocc.extras.recorders.poses import TimedPoses, stated_pose
from omniocc.images import Depth

LIDAR_KEYS = dict.fromkeys(("ego_from_lidar", "classes", "label_field", "own_car_m")) | {"topic": ..., "deskew": True}
"""Options of the LiDAR and their defaults; `...` is needed."""
TF = "tf"
IMAGES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")
CLOUDS = ("sensor_msgs/msg/PointCloud2",)
INFOS = ("sensor_msgs/msg/CameraInfo",)
POSES = ("nav_msgs/msg/Odometry", "geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/PoseWithCovarianceStamped")
TRANSFORMS = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")


class Address(NamedTuple):
    """Where a message lies: its topic, the time of its receipt, ns, and its place among those of that time.

    `stamp_ns` is the time in its header, without rounding; that of receipt where the header has none.
    """

    topic: str
    received_ns: int
    place: int
    stamp_ns: int


class Topic(NamedTuple):
    """The messages of a topic in the order of time.

    Attributes:
        times_s: (S,) increasing, as their headers state.
        addresses: of the messages.
        frame: in which they are, as the first header states.
    """

    times_s: Float64[np.ndarray, " S"]
    addresses: tuple[Address, ...]
    frame: str


class RosBag(LogRecorder):
    """A recorder of a ROS bag; options are described in `conf/recorder/bag.yaml`.

    Args:
        name: of the scene, and of its folder.
        bag: file of ROS 1 (`.bag`) or folder of ROS 2.
        rig: calibration in any format that `Rig.load` reads; None: CameraInfo and tf_static.
        cameras: topic of the images of each camera by its name (in the rig, if one is given).
        camera_info: topic of the CameraInfo of each camera; needed without a rig.
        poses: topic of Odometry or PoseStamped; `tf`: the pose of `base_frame` in `world_frame`.
        world_frame: name in tf.
        base_frame: name in tf of the frame of the vehicle.
        ego_from_base: pose of that frame, which the poses are of, in the ego frame; None: it is the ego frame.
        lidar: None, or a mapping with the keys of `LIDAR_KEYS`.
        reference: see `Timing`, as `limit_s`, `interval_s` and `pose_gap_s`.
        image_size: see `SceneOptions`, as `panorama`, `road_z_m` and `moving`.
        image_bits: how many of the bits of images of 16 are used; None: not known.
        origin_above_road_m: see `LogRecorder`.

    Raises:
        ValueError: naming the option that is impossible.
    """

    def __init__(
        self,
        name: str,
        bag: str,
        rig: str | None,
        cameras: Mapping[str, str],
        camera_info: Mapping[str, str] | None,
        poses: str,
        world_frame: str,
        base_frame: str,
        ego_from_base: Any,
        lidar: Mapping[str, Any] | None,
        reference: str | None,
        limit_s: float,
        interval_s: float | None,
        pose_gap_s: float,
        image_size: tuple[int, int] | None,
        panorama: tuple[int, int, float, float],
        road_z_m: float | None,
        moving: bool | None,
        image_bits: int | None = None,
        origin_above_road_m: float | None = None,
    ):
        super().__init__(
            name,
            Timing(reference, limit_s, interval_s, pose_gap_s),
            SceneOptions(image_size, panorama, road_z_m, moving),
            origin_above_road_m,
        )
        self.bag, self.rig_file, self.depth = Path(bag), rig, Depth(image_bits, "recorder.image_bits")
        if not cameras:
            raise ValueError("cameras is empty; give the topic of at least one camera: {front: /front/image_raw}")
        if rig is None and set(camera_info or {}) != set(cameras):
            raise ValueError(f"camera_info: without a rig give one topic for each of {', '.join(cameras)}")
        self.cameras, self.camera_info = dict(cameras), dict(camera_info or {})
        self.poses, self.world_frame, self.base_frame = poses, world_frame, base_frame
        self.ego_from_base = np.eye(4) if ego_from_base is None else stated_pose("ego_from_base", ego_from_base)
        self.lidar = None if lidar is None else lidar_options(lidar, LIDAR_KEYS)

    @contextmanager
    def open(self) -> Iterator[Log]:
        """Give the log while its bag is open; images and scans are read when they are asked for.

        Raises:
            UserError, DataError: naming the option, topic or message that cannot be used.
        """
        with Bag(self.bag) as bag:
            yield self._read(bag)

    def _read(self, bag: "Bag") -> Log:
        tree = bag.tree()
        topics = image_topics(bag, self.cameras)
        rig = self._rig(bag, tree, topics)
        images = [topics[name] for name in rig.names]
        poses = poses_of(bag, tree, self.poses, self.world_frame, self.base_frame)
        scans, given = (None, []) if self.lidar is None else self._scans(bag, tree, self.lidar)
        return Log(
            place=str(self.bag),
            rig=rig,
            image_times_s=tuple(topic.times_s for topic in images),
            read_image=image_reader(bag, images, rig, self.depth),
            pose_times_s=poses.times_s,
            world_from_ego=poses.poses @ inverse(self.ego_from_base),
            scans=scans,
            facts={"recorder": "bag", "poses": self.poses, "limit_s": self.timing.limit_s},
            inputs=[
                str(self.bag.absolute()),
                bag.reader.extent,
                sorted(self.cameras.items()),
                *given,
                *stated_depth(self.depth),
            ],
        )

    def _rig(self, bag: "Bag", tree: FrameTree, topics: Mapping[str, Topic]) -> Rig:
        if self.rig_file is not None:
            try:
                return chosen_rig(Rig.load(self.rig_file), list(self.cameras))
            except ValueError as error:
                raise UserError(f"rig: {error}") from error
        infos = {name: self.camera_info[name] for name in self.cameras}
        return rig_of_infos(bag, tree, topics, infos, self.cameras, self.base_frame, self.ego_from_base)

    def _scans(self, bag: "Bag", tree: FrameTree, options: Mapping[str, Any]) -> tuple[Scans, list[Any]]:
        """Return the scans, and plain values that differ when other options would give other points."""
        topic = bag.topic("lidar.topic", options["topic"], CLOUDS)
        classes = read_point_classes(None if options["classes"] is None else Path(options["classes"]))
        ego_from_lidar = options["ego_from_lidar"]
        if ego_from_lidar is None:
            ego_from_lidar = self.ego_from_base @ tree.fixed(self.base_frame, topic.frame)

        def cloud_of_message(number: int) -> RawCloud:
            message, where = bag.message(topic.addresses[number])
            return cloud_of(message, options["label_field"], where)

        def name(number: int) -> str:
            return bag.where(topic.addresses[number])

        scans = scans_of(topic.times_s, cloud_of_message, name, ego_from_lidar, classes, options)
        return scans, plain_options({**options, "pose": ego_from_lidar}, classes)


def image_topics(bag: "Bag", cameras: Mapping[str, str]) -> dict[str, Topic]:
    """Return the topic of images of each camera by its name; errors are those of `Bag.topic`."""
    return {name: bag.topic(f"cameras.{name}", topic, IMAGES) for name, topic in cameras.items()}


def image_reader(bag: "Bag", images: Sequence[Topic], rig: Rig, depth: Depth) -> ReadImage:
    """Return the function that reads an image of an open bag, by camera of the rig and number in its topic."""

    def read_image(camera: int, number: int) -> tuple[UInt8[np.ndarray, "height width 3"], str]:
        message, where = bag.message(images[camera].addresses[number])
        return image_of(message, where, rig.cameras[camera], depth), where

    return read_image


def rig_of_infos(
    bag: "Bag",
    tree: FrameTree,
    topics: Mapping[str, Topic],
    infos: Mapping[str, str],
    images: Mapping[str, str],
    base_frame: str,
    ego_from_base: Float64[np.ndarray, "4 4"],
) -> Rig:
    """Return the rig of the topics of CameraInfo by camera, and of the poses in tf that never change.

    `images` are the topics of images by camera; their names tell rectified ones.

    Raises:
        UserError, DataError: naming the topic, frame or message that cannot be used.
    """
    cameras, poses = [], []
    for name, topic in infos.items():
        info = bag.topic(f"camera_info.{name}", topic, INFOS)
        cameras.append(camera_of(*bag.message(info.addresses[0]), is_rectified(images[name])))
        poses.append(ego_from_base @ tree.fixed(base_frame, info.frame or topics[name].frame))
    return Rig(tuple(cameras), torch.from_numpy(np.stack(poses)), tuple(infos))


def is_rectified(topic: str) -> bool:
    """Return whether images of a topic have no distortion any more, by the names of ROS: `/front/image_rect_color`."""
    return any(part.startswith("image_rect") for part in topic.split("/"))


def poses_of(bag: "Bag", tree: FrameTree, poses: str, world_frame: str, base_frame: str) -> TimedPoses:
    """Return the poses of `base_frame` in `world_frame` by tf, or those of a topic.

    Raises:
        UserError, DataError: naming the topic, frame or message that cannot be used.
    """
    if poses == TF:
        return tree.over_time(world_frame, base_frame)
    topic = bag.topic("poses", poses, POSES)
    samples = []
    for time_s, address in zip(topic.times_s, topic.addresses, strict=True):
        message, where = bag.message(address)
        pose = message.pose.pose if hasattr(message.pose, "pose") else message.pose
        samples.append((float(time_s), pose_of(pose.position, pose.orientation, where)))
    return timed(samples)


class Bag:
    """An open bag; use it as a context manager.

    Args:
        path: file of ROS 1 (`.bag`) or folder of ROS 2.

    Raises:
        UserError: if the package rosbags is missing, or the bag is.
        DataError: if the bag cannot be read.
    """

    def __init__(self, path: Path):
        try:
            from omniocc.extras.recorders.bag_reader import BagReader
        except ImportError as error:
            raise UserError(f"ROS bags are read by the package rosbags: {installing('bag')}") from error
        if not path.exists():
            raise UserError(f"bag={path}: there is no such file or folder")
        self.path, self.reader = path, BagReader(path)

    def __enter__(self) -> "Bag":
        try:
            self.reader.__enter__()
        except Exception as error:  # of rosbags and of what it reads with
            raise self._unreadable(error) from error
        return self

    def __exit__(self, *_: object) -> None:
        self.reader.__exit__()

    def topic(self, option: str, name: str, kinds: Sequence[str]) -> Topic:
        """Return the messages of a topic by the time in their headers, or of receipt where a header has none.

        Raises:
            UserError: naming the option, and the topics of this kind that there are, or if it has no messages.
            DataError: if a message is damaged.
        """
        found = [connection for connection in self.reader.connections if connection.topic == name]
        if not found or found[0].msgtype not in kinds:
            have = sorted({connection.topic for connection in self.reader.connections if connection.msgtype in kinds})
            problem = f"is of type {in_line(found[0].msgtype)}" if found else "is not in the bag"
            raise UserError(
                f"{option}={name}: the topic {problem}; topics that fit: {in_line(', '.join(have)) or 'none'}"
            )
        stamps, frame, counts = {}, None, {}
        for received_ns, message in self._messages(name):
            place = counts.setdefault(received_ns, 0)
            counts[received_ns] += 1
            address = Address(name, received_ns, place, stamp_ns(message) or received_ns)
            stamps.setdefault(stamp_s(message) or received_ns / 1e9, address)
            frame = message.header.frame_id if frame is None else frame
        if not stamps:
            raise UserError(f"{option}={name}: the topic has no messages in {self.path}")
        times_s = sorted(stamps)
        return Topic(np.array(times_s), tuple(stamps[time_s] for time_s in times_s), frame or "")

    def where(self, address: Address) -> str:
        """Return the file, topic and time of a message, for error messages."""
        return f"{self.path}, {in_line(address.topic)} at {address.received_ns} ns"

    def message(self, address: Address) -> tuple[Any, str]:
        """Return a message and where it is, for error messages; raise DataError if it cannot be read."""
        where = self.where(address)
        span = (address.received_ns, address.received_ns + 1)
        for place, (_, message) in enumerate(self._messages(address.topic, *span)):
            if place == address.place:
                return message, where
        raise DataError(f"{where}: the message is missing; the bag is damaged")

    def tree(self) -> FrameTree:
        """Return the coordinate frames that the topics of tf state; of a topic named `...static` they never change."""
        tree = FrameTree()
        topics = {connection.topic for connection in self.reader.connections if connection.msgtype in TRANSFORMS}
        for topic in sorted(topics):
            for received_ns, message in self._messages(topic):
                for one in message.transforms:
                    time_s = None if topic.endswith("static") else stamp_s(one) or received_ns / 1e9
                    pose = pose_of(one.transform.translation, one.transform.rotation, f"{self.path}, {in_line(topic)}")
                    tree.add(one.header.frame_id, one.child_frame_id, time_s, pose)
        return tree

    def _messages(
        self, topic: str, start_ns: int | None = None, stop_ns: int | None = None
    ) -> Iterator[tuple[int, Any]]:
        """Yield the time of receipt, ns, and the content of messages of a topic."""
        connections = [connection for connection in self.reader.connections if connection.topic == topic]
        try:
            yield from self.reader.messages(connections, start_ns, stop_ns)
        except Exception as error:  # of rosbags and of what it reads with
            raise self._unreadable(error, topic) from error

    def _unreadable(self, error: Exception, topic: str = "") -> DataError:
        if isinstance(error, DataError):
            return error
        where = f"{self.path}, {in_line(topic)}" if topic else str(self.path)
        remedy = "'rosbag reindex' or 'ros2 bag reindex' mends bags whose recording was cut off"
        return DataError(f"{where}: the bag cannot be read: {type(error).__name__}: {in_line(str(error))}; {remedy}")
