"""Messages of ROS as arrays, cameras and poses, and the tree of coordinate frames that those of tf make.

As the package rosbags reads them, their fields have equal names in ROS 1 and 2 but for CameraInfo.
"""

import re
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float64, UInt8

from omniocc.camera import MEI, Camera, KannalaBrandt, Pinhole
from omniocc.data.formats.clouds import LABEL_FIELDS, TIME_FIELDS, RawCloud, came_back
from omniocc.data.formats.files import named_once, rgb_of_camera, whole_numbers
from omniocc.data.formats.poses import inverse, quaternion_pose
from omniocc.errors import DataError, UserError, in_line
from omniocc.extras.recorders.poses import TimedPoses
from omniocc.extras.recorders.streams import interpolate
from omniocc.images import Depth, eight_bits

CHANNELS = {"rgb8": 3, "bgr8": 3, "rgba8": 4, "bgra8": 4, "mono8": 1, "8UC1": 1, "8UC3": 3}
TO_RGB = {
    "bgr8": cv2.COLOR_BGR2RGB,
    "8UC3": cv2.COLOR_BGR2RGB,
    "rgba8": cv2.COLOR_RGBA2RGB,
    "bgra8": cv2.COLOR_BGRA2RGB,
    "mono8": cv2.COLOR_GRAY2RGB,
    "8UC1": cv2.COLOR_GRAY2RGB,
    "bayer_rggb8": cv2.COLOR_BayerRGGB2RGB,
    "bayer_bggr8": cv2.COLOR_BayerBGGR2RGB,
    "bayer_gbrg8": cv2.COLOR_BayerGBRG2RGB,
    "bayer_grbg8": cv2.COLOR_BayerGRBG2RGB,
    "yuv422": cv2.COLOR_YUV2RGB_UYVY,
    "yuv422_yuy2": cv2.COLOR_YUV2RGB_YUY2,
}
"""Conversions of the encodings of sensor_msgs that are read; rgb8 needs none."""
WORDS = re.compile(r"(mono|rgb|bgr|rgba|bgra|bayer_(?:rggb|bggr|gbrg|grbg))(10|12|14|16)")
"""Encodings of samples in words of 16 bits: the channels, and how many of the bits are used; of 16 fewer may be."""
POINT_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
"""Numpy's names of the data types of sensor_msgs/PointField."""
LONGEST_POINT = 1 << 20
"""Most bytes of a point."""
FISHEYE = ("equidistant", "fisheye", "kannala_brandt")


def stamp_s(message: Any) -> float:
    """Return the time in the header of a message, s; 0 if its sender has set none."""
    stamp = message.header.stamp
    return stamp.sec + stamp.nanosec / 1e9


def stamp_ns(message: Any) -> int:
    """Return the same in ns, without rounding."""
    stamp = message.header.stamp
    return stamp.sec * 10**9 + stamp.nanosec


def image_of(message: Any, where: str, camera: Camera, depth: Depth) -> UInt8[np.ndarray, "height width 3"]:
    """Return the RGB of an Image or CompressedImage of a camera; `depth` is that of samples in words of 16 bits.

    Raises:
        DataError: for other encodings, damaged images, and compressed ones of another aspect ratio than the camera's.
    """
    if hasattr(message, "format"):
        return rgb_of_camera(bytes(message.data), f"{where} ({in_line(message.format)})", camera, depth)
    words = WORDS.fullmatch(message.encoding)
    encoding = f"{words[1]}8" if words else message.encoding
    if encoding != "rgb8" and encoding not in TO_RGB:
        known = f"rgb8, {', '.join(TO_RGB)}, and those of 10 to 16 bits in words"
        raise DataError(f"{where}: the encoding {in_line(encoding)} cannot be read; known are {known}")
    channels = 2 if encoding.startswith("yuv") else CHANNELS.get(encoding, 1)
    if words is None:
        pixels = _pixels(message, channels, np.dtype(np.uint8), where)
    else:
        pixels = _pixels(message, channels, np.dtype(">u2" if message.is_bigendian else "<u2"), where)
        stated = depth if words[2] == "16" else Depth(int(words[2]), message.encoding)
        pixels = eight_bits(pixels, stated.white(int(pixels.max()), where))
    try:
        return pixels.copy() if encoding == "rgb8" else cv2.cvtColor(pixels, TO_RGB[encoding])
    except cv2.error as error:  # of pairs of pixels in odd widths, and of mosaics smaller than their pattern
        size = f"{message.width}x{message.height} px"
        raise DataError(f"{where}: an image of {size} cannot have the encoding {message.encoding}") from error


def _pixels(message: Any, channels: int, dtype: np.dtype, where: str) -> np.ndarray:
    """Return the samples of an Image, (height, width, channels); raise DataError if it has none, or too few bytes."""
    height, width, content = message.height, message.width, np.frombuffer(message.data, np.uint8)
    row_bytes = width * channels * dtype.itemsize
    if not height * width or message.step < row_bytes or len(content) < height * message.step:
        size = f"{width}x{height} px of {message.encoding}"
        raise DataError(f"{where}: {len(content)} bytes are too few, or too short in a row, for {size}")
    rows = content[: height * message.step].reshape(height, message.step)[:, :row_bytes]
    return np.ascontiguousarray(rows).view(dtype).reshape(height, width, channels)


def camera_of(message: Any, where: str, rectified: bool = False) -> Camera:
    """Return the camera of a CameraInfo: matrix K and distortion D of the image as it was taken, P of a rectified one.

    `plumb_bob` without distortion is a pinhole, with k1, k2, p1 and p2 it is `MEI` with xi = 0, which is the same
    projection; `equidistant` is `KannalaBrandt`.

    Raises:
        DataError: for another distortion, a cut-out of the image, turned images, or numbers that make no camera.
    """
    matrix, distortion = (_field(message, name) for name in ("k", "d"))
    model, coefficients = str(message.distortion_model).lower(), [float(value) for value in distortion]
    roi = message.roi
    if max(message.binning_x, message.binning_y) > 1 or roi.x_offset or roi.y_offset:
        raise DataError(f"{where}: binning and cut-outs (roi) are not supported; give rig=<file> instead")
    fx, skew, cx, _, fy, cy, *_ = (float(value) for value in matrix)
    turn = np.eye(3)
    if rectified and any(coefficients):
        turn = np.array(_field(message, "r"), np.float64).reshape(3, 3)
        projection = np.array(_field(message, "p"), np.float64).reshape(3, 4)
        (fx, skew, cx), (_, fy, cy) = projection[0, :3].tolist(), projection[1, :3].tolist()
        model, coefficients = "", []
    size, focal_px, center_px = (int(message.width), int(message.height)), (fx, fy), (cx, cy)
    try:
        if skew:
            raise ValueError(f"the skew is {skew}; it must be 0")
        if not np.allclose(turn, np.eye(3), atol=1e-4):
            raise ValueError("the images are rectified and turned (R); give rig=<file> instead")
        if model in FISHEYE:
            return KannalaBrandt(*size, focal_px, center_px, tuple(coefficients), 180.0)
        if not any(coefficients):
            return Pinhole(*size, focal_px, center_px)
        if model in ("plumb_bob", "radtan") and not any(coefficients[4:]) and len(coefficients) >= 4:
            return MEI(*size, focal_px, center_px, 0.0, tuple(coefficients[:4]), 180.0)
        raise ValueError(
            f"the distortion {in_line(f'{model} {coefficients}')} is not supported; give rig=<file> instead"
        )
    except ValueError as error:
        raise DataError(f"{where}: {error}") from error


def cloud_of(message: Any, label_field: str | None, where: str) -> RawCloud:
    """Return the points of a PointCloud2, in the frame of its sender, and the class ids and times in fields of it.

    Raises:
        DataError: if a field is missing, stands twice or is none of whole numbers, or the message is cut short.
    """
    order = ">" if message.is_bigendian else "<"
    named_once([field.name for field in message.fields if field.name.strip("_")], f"{where}: the field")
    fields = {field.name: field for field in message.fields if field.count <= 1 and field.datatype in POINT_TYPES}
    labels = (label_field,) if label_field is not None else tuple(name for name in LABEL_FIELDS if name in fields)[:1]
    times = tuple(name for name in TIME_FIELDS if name in fields)[:1]
    wanted = dict.fromkeys(("x", "y", "z", *labels, *times))
    if missing := [name for name in wanted if name not in fields]:
        raise DataError(f"{where}: the field '{missing[0]}' is missing; the points have {in_line(', '.join(fields))}")
    sizes = {name: fields[name].offset + np.dtype(POINT_TYPES[fields[name].datatype]).itemsize for name in wanted}
    if beyond := [name for name, end in sizes.items() if end > message.point_step]:
        raise DataError(f"{where}: the field '{beyond[0]}' ends beyond the {message.point_step} bytes of a point")
    if message.point_step > LONGEST_POINT:
        raise DataError(f"{where}: a point has {message.point_step:,} bytes; at most {LONGEST_POINT:,} are read")
    dtype = np.dtype(
        {
            "names": list(wanted),
            "formats": [order + POINT_TYPES[fields[name].datatype] for name in wanted],
            "offsets": [fields[name].offset for name in wanted],
            "itemsize": message.point_step,
        }
    )
    content, row_bytes = np.frombuffer(message.data, np.uint8), message.width * message.point_step
    if message.row_step < row_bytes:
        raise DataError(
            f"{where}: its row_step is {message.row_step}, but a row of {message.width:,} points of "
            f"{message.point_step} bytes has {row_bytes:,}; its sender must set row_step to that"
        )
    if len(content) < message.height * message.row_step:
        raise DataError(f"{where}: {len(content)} bytes are too few for {message.height}x{message.width} points")
    rows = content[: message.height * message.row_step].reshape(message.height, message.row_step)
    table = np.ascontiguousarray(rows[:, :row_bytes]).reshape(-1).view(dtype)
    points = np.stack([table[axis] for axis in "xyz"], axis=1).astype(np.float32)
    kept = came_back(points)
    ids = [whole_numbers(table[name][kept], f"{where}: its field '{name}'") for name in labels]
    return RawCloud(points[kept], ids[0] if ids else None, table[times[0]][kept] if times else None)


def pose_of(position: Any, rotation: Any, where: str) -> Float64[np.ndarray, "4 4"]:
    """Return the pose of a position (or translation) and a quaternion of geometry_msgs; DataError if they make none."""
    quaternion: Sequence[float] = (rotation.w, rotation.x, rotation.y, rotation.z)
    try:
        return quaternion_pose(quaternion, (position.x, position.y, position.z), "the pose")
    except ValueError as error:
        raise DataError(f"{where}: {error}") from error


def _field(message: Any, name: str) -> Any:
    return getattr(message, name) if hasattr(message, name) else getattr(message, name.upper())  # ROS 2, ROS 1


@dataclass
class FrameTree:
    """Poses of child frames in their parents.

    Attributes:
        static: parent_from_child by (parent, child).
        moving: times (s) and poses by (parent, child), in the order in which they were added.
    """

    static: dict[tuple[str, str], Float64[np.ndarray, "4 4"]] = field(default_factory=dict)
    moving: dict[tuple[str, str], list[tuple[float, Float64[np.ndarray, "4 4"]]]] = field(default_factory=dict)

    def add(self, parent: str, child: str, time_s: float | None, parent_from_child: Float64[np.ndarray, "4 4"]) -> None:
        """Add a pose; a time of None means that it never changes."""
        key = parent.lstrip("/"), child.lstrip("/")
        if time_s is None:
            self.static[key] = parent_from_child
        else:
            self.moving.setdefault(key, []).append((time_s, parent_from_child))

    @property
    def names(self) -> list[str]:
        """Return the names of all frames."""
        return sorted({name for pair in (*self.static, *self.moving) for name in pair})

    def moves(self, target: str, source: str) -> bool:
        """Return whether there is a chain of poses between two frames, and a moving one in it."""
        try:
            chain = self._chain(target, source, {**self.static, **self.moving})
        except UserError:
            return False
        return any((parent, child) in self.moving for parent, child, _ in chain)

    def fixed(self, target: str, source: str) -> Float64[np.ndarray, "4 4"]:
        """Return target_from_source over poses that never change; raise UserError naming frames that there are."""
        pose = np.eye(4)
        for parent, child, downwards in self._chain(target, source, self.static):
            step = self.static[parent, child]
            pose = pose @ (step if downwards else inverse(step))
        return pose

    def over_time(self, target: str, source: str) -> TimedPoses:
        """Return target_from_source at the times of the moving pose between them that is stated most often.

        Other moving poses of the chain are interpolated at these times and held before the first and after the last.

        Raises:
            UserError: naming the frames that there are, or if nothing between the two moves.
        """
        chain = self._chain(target, source, {**self.static, **self.moving})
        steps = [(parent, child) for parent, child, _ in chain]
        streams = {step: timed(self.moving[step]) for step in steps if step in self.moving}
        if not streams:
            raise UserError(f"poses: tf states no moving pose between '{target}' and '{source}'")
        times_s = max(streams.values(), key=lambda stream: len(stream.times_s)).times_s
        poses = np.broadcast_to(np.eye(4), (len(times_s), 4, 4))
        for parent, child, downwards in chain:
            step = held(streams[parent, child], times_s) if (parent, child) in streams else self.static[parent, child]
            poses = poses @ (step if downwards else inverse(step))
        return TimedPoses(times_s, poses)

    def _chain(self, target: str, source: str, edges: Mapping[tuple[str, str], object]) -> list[tuple[str, str, bool]]:
        """Return the steps from target to source: parent, child, and whether the step goes to the child."""
        target, source = target.lstrip("/"), source.lstrip("/")
        steps: dict[str, list[tuple[str, tuple[str, str, bool]]]] = {}
        for parent, child in edges:
            steps.setdefault(parent, []).append((child, (parent, child, True)))
            steps.setdefault(child, []).append((parent, (parent, child, False)))
        before: dict[str, tuple[str, tuple[str, str, bool]] | None] = {target: None}
        queue = deque([target])
        while queue:
            here = queue.popleft()
            for other, step in steps.get(here, []):
                if other not in before:
                    before[other] = here, step
                    queue.append(other)
        if source not in before:
            known = in_line(", ".join(sorted(steps))) or "none"
            raise UserError(
                f"tf: there is no chain of poses from '{target}' to '{source}'; frames: {known}. A rig file "
                "(rig; recorder.rig) and recorder.lidar.ego_from_lidar can state what the bag does not"
            )
        chain = []
        while last := before[source]:
            source, step = last
            chain.append(step)
        return chain[::-1]


def timed(samples: list[tuple[float, Float64[np.ndarray, "4 4"]]]) -> TimedPoses:
    """Return samples in the order of time; of equal times the first one."""
    times_s, first = np.unique([time_s for time_s, _ in samples], return_index=True)
    return TimedPoses(times_s, np.stack([samples[place][1] for place in first]))


def held(stream: TimedPoses, at_s: Float64[np.ndarray, " F"]) -> Float64[np.ndarray, "F 4 4"]:
    """Return poses interpolated at times; before the first and after the last pose, that pose."""
    return interpolate(stream.times_s, stream.poses, at_s.clip(stream.times_s[0], stream.times_s[-1]), 0.0)[0]
