"""Write predictions as a bag of ROS 2 in one mcap file, by the package rosbags."""

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore
from scipy.spatial.transform import Rotation

from omniocc.errors import DataError
from omniocc.io import cannot_write
from omniocc.predict.output.bag import BagContent, BagFrame
from omniocc.progress import Progress

VOXEL_TOPIC, POINT_TOPIC, RANGE_TOPIC, STATIC = "/omniocc/voxels", "/omniocc/points", "/omniocc/range", "/tf_static"
TOPICS = frozenset({VOXEL_TOPIC, POINT_TOPIC, RANGE_TOPIC, STATIC})
PANORAMA = "omniocc_panorama"
"""Frame of the range panorama: its axes are those of the ego frame."""
VERSION = 8
"""Of rosbag2: ROS 2 Humble cannot read the qualities of service of version 9."""
FLOAT32, UINT32 = 7, 6
"""Data types of sensor_msgs/PointField."""
CLOUD, IMAGE, TRANSFORMS = "sensor_msgs/msg/PointCloud2", "sensor_msgs/msg/Image", "tf2_msgs/msg/TFMessage"
_NONE = QosTime(0, 0)
LATCHED = Qos(
    QosHistory.KEEP_LAST,
    1,
    QosReliability.RELIABLE,
    QosDurability.TRANSIENT_LOCAL,
    _NONE,
    _NONE,
    QosLiveliness.AUTOMATIC,
    _NONE,
    False,
)
"""Transforms that never change are told to programs that start later too."""


def write_bag(path: Path, content: BagContent) -> None:
    """Write the predicted frames, whole or not at all; they are read one at a time.

    Raises:
        DataError: naming the file that cannot be written, or read.
    """
    partial = path.with_name(f".{path.name}.partial")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        shutil.rmtree(partial, ignore_errors=True)  # of a process that was killed
        made = partial / path.stem  # a bag of ROS 2 states the name of its file, which is that of its folder
        with Writer(made, version=VERSION, storage_plugin=StoragePlugin.MCAP) as writer:
            _write_frames(writer, path, content)
        (made / path.name).replace(path)
    except DataError:  # of a frame that cannot be read
        raise
    except OSError as error:
        raise cannot_write(path, error) from error
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def _write_frames(writer: Writer, path: Path, content: BagContent) -> None:
    store, topics = get_typestore(Stores.LATEST), {}
    make: Callable[..., Any] = lambda kind, **fields: store.types[kind](**fields)  # noqa: E731

    def write(topic: str, kind: str, stamp_ns: int, message: Any) -> None:
        if topic not in topics:
            qualities = [LATCHED] if topic == STATIC else []
            topics[topic] = writer.add_connection(topic, kind, typestore=store, offered_qos_profiles=qualities)
        writer.write(topics[topic], stamp_ns, store.serialize_cdr(message, kind))

    with Progress(f"writing {path}", content.total) as progress:
        for number, frame in enumerate(content.frames):
            if number == 0:
                write(STATIC, TRANSFORMS, frame.stamp_ns, transforms_of(make, content, frame.stamp_ns))
            topic = POINT_TOPIC if frame.labels is None else VOXEL_TOPIC
            write(topic, CLOUD, frame.stamp_ns, cloud_message(make, frame, content.mount.frame))
            if frame.range_m is not None:
                write(RANGE_TOPIC, IMAGE, frame.stamp_ns, range_message(make, frame))
            progress.advance()
    print(f"{path}: {content.total} frames; topics {', '.join(topics)}; frame {content.mount.frame}")


def header_of(make: Callable[..., Any], stamp_ns: int, frame: str) -> Any:
    """Return a header; `make` returns a message of a type by its fields."""
    stamp = make("builtin_interfaces/msg/Time", sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
    return make("std_msgs/msg/Header", stamp=stamp, frame_id=frame)


def cloud_message(make: Callable[..., Any], frame: BagFrame, frame_id: str) -> Any:
    """Return a PointCloud2 with x, y, z (float32, m), rgb (0x00rrggbb in a float32, as RViz reads it) and label."""
    kinds = {"x": ("<f4", FLOAT32), "y": ("<f4", FLOAT32), "z": ("<f4", FLOAT32), "rgb": ("<u4", FLOAT32)}
    kinds |= {} if frame.labels is None else {"label": ("<u4", UINT32)}
    table = np.zeros(len(frame.points_m), [(name, dtype) for name, (dtype, _) in kinds.items()])
    table["x"], table["y"], table["z"] = frame.points_m.T
    table["rgb"] = frame.colors.astype(np.uint32) @ np.array([1 << 16, 1 << 8, 1], np.uint32)
    if frame.labels is not None:
        table["label"] = frame.labels
    fields = [
        make("sensor_msgs/msg/PointField", name=name, offset=4 * place, datatype=kind, count=1)
        for place, (name, (_, kind)) in enumerate(kinds.items())
    ]
    return make(
        CLOUD,
        header=header_of(make, frame.stamp_ns, frame_id),
        height=1,
        width=len(table),
        fields=fields,
        is_bigendian=False,
        point_step=table.itemsize,
        row_step=table.nbytes,
        data=np.frombuffer(table.tobytes(), np.uint8),
        is_dense=True,
    )


def range_message(make: Callable[..., Any], frame: BagFrame) -> Any:
    """Return an Image of the range panorama: 32FC1, m, nan where there is no answer."""
    assert frame.range_m is not None
    rows = np.ascontiguousarray(frame.range_m, "<f4")
    return make(
        IMAGE,
        header=header_of(make, frame.stamp_ns, PANORAMA),
        height=rows.shape[0],
        width=rows.shape[1],
        encoding="32FC1",
        is_bigendian=0,
        step=rows.strides[0],
        data=np.frombuffer(rows.tobytes(), np.uint8),
    )


def transforms_of(make: Callable[..., Any], content: BagContent, stamp_ns: int) -> Any:
    """Return where the panorama is in the ego frame, and the ego frame in a frame of the bag that was read."""
    mount, raised = content.mount, np.eye(4)
    raised[2, 3] = content.panorama_z_m
    poses = [(mount.frame, PANORAMA, raised)]
    if mount.base is not None and mount.base_from_ego is not None:
        poses.append((mount.base, mount.frame, mount.base_from_ego))
    stamped = []
    for parent, child, pose in poses:
        place = dict(zip("xyz", pose[:3, 3].tolist(), strict=True))
        turn = dict(zip("xyzw", Rotation.from_matrix(pose[:3, :3]).as_quat().tolist(), strict=True))
        moved = make(
            "geometry_msgs/msg/Transform",
            translation=make("geometry_msgs/msg/Vector3", **place),
            rotation=make("geometry_msgs/msg/Quaternion", **turn),
        )
        header = header_of(make, stamp_ns, parent)
        stamped.append(make("geometry_msgs/msg/TransformStamped", header=header, child_frame_id=child, transform=moved))
    return make(TRANSFORMS, transforms=stamped)
