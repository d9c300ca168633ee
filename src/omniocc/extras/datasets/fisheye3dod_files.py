"""Files of Fisheye3DOD: poses of sensors as CARLA prints them, and points of the semantic LiDAR.

Format: utils/fisheye3dod_calib.py and dataset/loading.py of https://github.com/weiyangdaren/Fisheye3DOD
"""

import re
from pathlib import Path

import numpy as np
from jaxtyping import Float32, Float64, UInt8

from omniocc.data.formats.clouds import came_back, read_rows
from omniocc.data.formats.files import read_text
from omniocc.errors import DataError
from omniocc.extras.unreal import UnrealPose, pose_of
from omniocc.io import number_of

METADATA = "sensor_metadata.txt"
NUMBER = r"([-+.\deE]+)"
TRANSFORM = re.compile(
    rf"frame=(\d+),.*?Transform\(Location\(x={NUMBER},\s*y={NUMBER},\s*z={NUMBER}\),\s*"
    rf"Rotation\(pitch={NUMBER},\s*yaw={NUMBER},\s*roll={NUMBER}\)\)"
)


def read_poses(folder: Path) -> dict[int, Float64[np.ndarray, "4 4"]]:
    """Return world_from_sensor of every frame in a sensor's `sensor_metadata.txt`, by number.

    All frames have x forward, y left, z up: they are the mirror images of CARLA's, whose y points right. (The dataset's
    own code turns pitch and roll the other way, which shows where a car does not stand level.)

    Raises:
        DataError: if the file is missing or has no pose.
    """
    path = folder / METADATA
    poses: dict[int, Float64[np.ndarray, "4 4"]] = {}
    for frame, *values in TRANSFORM.findall(read_text(path, "unpack the whole recording")):
        if int(frame) in poses:
            raise DataError(f"{path}: frame {frame} stands twice; keep one")
        try:
            poses[int(frame)] = pose_of(UnrealPose(*map(number_of, values)))
        except ValueError as error:
            raise DataError(f"{path}: frame {frame}: {error}") from error
    if not poses:
        raise DataError(f"{path}: there is no 'frame=..., ... Transform(Location(...), Rotation(...))' in it")
    return poses


def read_points(path: Path) -> tuple[Float32[np.ndarray, "P 3"], UInt8[np.ndarray, " P"]]:
    """Return points (m) and CARLA's tags of a file with six numbers for each ray: x, y, z, cosine, object, tag.

    Rays that did not come back are left out.
    The dataset's code does not say how these are stored. Tags are read as CARLA writes them (uint32) or as float32,
    whichever the file can be.

    Raises:
        DataError: if the file is missing or damaged, or its last numbers are no tags.
    """
    rows = read_rows(path, 6)
    rows = rows[came_back(rows[:, :3])]
    tags, floats = rows[:, 5].copy().view("<u4"), rows[:, 5]
    if tags.max(initial=0) > 255:
        if not ((floats >= 0) & (floats <= 255) & (floats == np.round(floats))).all():
            raise DataError(f"{path}: the last of the six numbers of a point is no tag of 0 to 255 for all points")
        tags = floats
    return rows[:, :3], tags.astype(np.uint8)
