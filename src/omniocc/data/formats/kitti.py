"""Files of KITTI's odometry benchmark, SemanticKITTI and SSCBench: calibration, poses, packed voxels, class ids.

Formats: https://github.com/PRBonn/semantic-kitti-api and https://github.com/ai4ce/SSCBench
"""

from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float64, UInt8, UInt32

from omniocc.classes import UNKNOWN, ClassTable, SemanticClass
from omniocc.data.formats.files import class_table, map_classes, read_array, read_text
from omniocc.data.formats.pose_table import read_matrices
from omniocc.data.formats.poses import inverse, rigid
from omniocc.errors import DataError
from omniocc.io import atomic_write, number_of, read_bytes

SHAPE = (256, 256, 32)
CELLS = 256 * 256 * 32
LOW_M, CELL_M = (0.0, -25.6, -2.0), 0.2
"""Lowest corner of the grid, velodyne frame (x forward, y left, z up), and the size of a voxel."""
CALIBRATION_REMEDY = "take calib.txt from the archive of the Velodyne scans; that of the images has no line 'Tr:'"

_COLORS = {
    "car": (100, 150, 245),
    "bicycle": (100, 230, 245),
    "motorcycle": (30, 60, 150),
    "truck": (80, 30, 180),
    "other-vehicle": (100, 80, 250),
    "person": (255, 30, 30),
    "bicyclist": (255, 40, 200),
    "motorcyclist": (150, 30, 90),
    "road": (255, 0, 255),
    "parking": (255, 150, 255),
    "sidewalk": (75, 0, 75),
    "other-ground": (175, 0, 75),
    "building": (255, 200, 0),
    "fence": (255, 120, 50),
    "vegetation": (0, 175, 0),
    "trunk": (135, 60, 0),
    "terrain": (150, 240, 80),
    "pole": (255, 240, 150),
    "traffic-sign": (255, 0, 0),
    "other-structure": (0, 150, 255),
    "other-object": (255, 255, 50),
}


def _table(names: list[str]) -> ClassTable:
    rows = [SemanticClass(k + 1, name, _COLORS[name]) for k, name in enumerate(names)]
    return ClassTable((SemanticClass(0, "empty", (255, 255, 255)), *rows))


SEMANTIC_KITTI = _table(list(_COLORS)[:19])
"""The 20 classes of semantic scene completion on SemanticKITTI."""
SSCBENCH = _table(
    [
        "car",
        "bicycle",
        "motorcycle",
        "truck",
        "other-vehicle",
        "person",
        "road",
        "parking",
        "sidewalk",
        "other-ground",
        "building",
        "fence",
        "vegetation",
        "terrain",
        "pole",
        "traffic-sign",
        "other-structure",
        "other-object",
    ]
)
"""The 19 classes of SSCBench-KITTI-360."""

SEMANTIC_KITTI_IDS = {
    1: (10, 252),
    2: (11,),
    3: (15,),
    4: (18, 258),
    5: (20, 13, 16, 256, 257, 259),
    6: (30, 254),
    7: (31, 253),
    8: (32, 255),
    9: (40, 60),
    10: (44,),
    11: (48,),
    12: (49,),
    13: (50,),
    14: (51,),
    15: (70,),
    16: (71,),
    17: (72,),
    18: (80,),
    19: (81,),
    UNKNOWN: (1, 52, 99),
}
"""Ids of each class in label files (semantic-kitti.yaml); submissions have the first. Ids under 255 do not count."""
SSCBENCH_IDS = {
    1: (10, 252),
    2: (11,),
    3: (15,),
    4: (18, 258),
    5: (20, 13, 16, 256, 257, 259),
    6: (30, 254),
    7: (40, 60),
    8: (44,),
    9: (48,),
    10: (49,),
    11: (50,),
    12: (51,),
    13: (70,),
    14: (72,),
    15: (80,),
    16: (81,),
    17: (52,),
    18: (99,),
    UNKNOWN: (1, 31, 32, 71, 253, 255),
}
"""The same table for SSCBench-KITTI-360 (dataset/configs/kitti360.yaml)."""


def classes_by_id(ids: dict[int, tuple[int, ...]]) -> np.ndarray:
    """Return the table by which `map_classes` maps ids of voxels: 0 is empty, ids that do not count become 255."""
    return class_table({0: 0} | {raw_id: class_id for class_id, raw_ids in ids.items() for raw_id in raw_ids})


def read_mask(path: Path) -> Bool[np.ndarray, "256 256 32"]:
    """Return a mask of voxels: one bit each, most significant first (SemanticKITTI), or one byte each (SSCBench).

    Raises:
        DataError: when the file cannot be read or has another size.
    """
    content = np.frombuffer(read_bytes(path), np.uint8)
    if len(content) == CELLS // 8:
        return np.unpackbits(content).reshape(SHAPE).astype(bool)
    if len(content) == CELLS:
        return (content != 0).reshape(SHAPE)
    expected = f"{CELLS // 8:,} or {CELLS:,}"
    raise DataError(f"{path}: the file has {len(content):,} bytes instead of {expected}; it is damaged")


def read_point_classes(path: Path, table: np.ndarray, kept: Bool[np.ndarray, " R"]) -> UInt8[np.ndarray, " P"]:
    """Return the classes of the `kept` points of a scan from its `.label` file; 255 for unlabelled points."""
    classes = map_classes(read_point_ids(path, kept) & 0xFFFF, table, path)  # the upper 16 bits number instances
    return np.where(classes == 0, UNKNOWN, classes).astype(np.uint8)


def read_point_ids(path: Path, kept: Bool[np.ndarray, " R"]) -> UInt32[np.ndarray, " P"]:
    """Return the ids of the `kept` points of a scan from its `.label` file.

    Raises:
        DataError: when the file cannot be read, or labels another number of points.
    """
    ids = read_array(path, "<u4", (-1,))
    if len(ids) != len(kept):
        scan = f"velodyne/{path.stem}.bin"
        raise DataError(f"{path} has labels of {len(ids):,} points, but {scan} has {len(kept):,}; one is damaged")
    return ids[kept]


def write_prediction(path: Path, classes: UInt8[np.ndarray, "256 256 32"], ids: dict[int, tuple[int, ...]]) -> None:
    """Write classes as a submission, in ids of 16 bits; raise DataError if the file cannot be written."""
    table = np.zeros(256, "<u2")
    for class_id, raw_ids in ids.items():
        table[class_id] = raw_ids[0]
    atomic_write(path, table[classes].tobytes())


def read_calibration(path: Path) -> dict[str, Float64[np.ndarray, "3 4"]]:
    """Return the matrices of a `calib.txt` by name, 'Tr' among them; raise DataError naming the line that is wrong."""
    matrices = {}
    for number, line in enumerate(read_text(path).splitlines(), start=1):
        name, _, values = line.partition(":")
        if not values.strip():
            continue
        if name.strip() in matrices:
            raise DataError(f"{path}, line {number}: '{name.strip()}:' stands twice; keep one")
        try:
            matrices[name.strip()] = np.reshape([number_of(word) for word in values.split()], (3, 4))
        except ValueError as error:
            raise DataError(f"{path}, line {number}: '{name}' are not 12 numbers") from error
    if "Tr" not in matrices:
        raise DataError(f"{path}: the line 'Tr:' is missing; {CALIBRATION_REMEDY}")
    try:
        rigid(matrices["Tr"], "Tr")
    except ValueError as error:
        raise DataError(f"{path}: {error}") from error
    return matrices


def camera_of(
    calibration: dict[str, Float64[np.ndarray, "3 4"]], number: int
) -> tuple[Float64[np.ndarray, "3 3"], Float64[np.ndarray, "4 4"]]:
    """Return the intrinsics of a rectified camera and its pose `velodyne_from_camera`.

    The last column of a camera's `P` is its intrinsics times its translation `camera_from_first`, from camera 0.

    Raises:
        ValueError: if the camera is missing, or `Tr` is not a rigid pose.
    """
    if f"P{number}" not in calibration:
        raise ValueError(f"there is no camera {number} in the calibration")
    projection = calibration[f"P{number}"]
    intrinsics = projection[:, :3]
    camera_from_first = np.eye(4)
    camera_from_first[:3, 3] = np.linalg.solve(intrinsics, projection[:, 3])
    return intrinsics, inverse(camera_from_first @ rigid(calibration["Tr"], "Tr"))


def read_poses(path: Path, first_from_velodyne: Float64[np.ndarray, "4 4"]) -> Float64[np.ndarray, "F 4 4"]:
    """Return the poses `world_from_velodyne` from a `poses.txt`, which has those of camera 0.

    The world is the velodyne frame of the first scan. `first_from_velodyne` is `Tr` of the calibration, to camera 0.

    Raises:
        DataError: naming the line that is no pose.
    """
    _, poses = read_matrices(path)
    return inverse(first_from_velodyne) @ poses @ first_from_velodyne


def is_first_release(occupied: Bool[np.ndarray, "F 256 256 32"]) -> bool:
    """Return whether the `.bin` voxels of some frames are from the release of 2019, which is one cell too high.

    Its lowest layer is always empty (https://github.com/PRBonn/semantic-kitti-api/issues/49).
    """
    return bool(occupied.any()) and not occupied[..., 0].any()
