"""KITTI-360: calibration, poses, and frames of SSCBench found among its own.

Formats: https://github.com/autonomousvision/kitti360Scripts
"""

import re
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float64, Int64, UInt8
from torch import Tensor

from omniocc.camera import MEI, Camera, Pinhole
from omniocc.camera.calibration.kitti360 import read_kitti360
from omniocc.data.formats.files import decode, read_text
from omniocc.data.formats.pose_table import read_matrices
from omniocc.data.formats.poses import inverse, rigid
from omniocc.errors import DataError
from omniocc.io import number_of, parse_yaml
from omniocc.progress import Progress

SEQUENCE = "2013_05_28_drive_00{}_sync"
RECTIFIED, FISHEYES = ("image_00", "image_01"), ("image_02", "image_03")
SIZE = (1408, 376)
"""Width and height of the rectified images, px."""
LENS_DEG = 97.5
"""Angle off the optical axis at which the image of the fisheyes ends."""
CAR_ROWS = (890 / 1400, 980 / 1400, 1050 / 1400, 1120 / 1400, 1190 / 1400, 1200 / 1400)
CAR_FREE = (0.5, 0.37, 0.28, 0.22, 0.04, 0.0)
"""Largest distance from the middle column of a fisheye's image at which it does not show the own car.

As a fraction of the width, at the heights of `CAR_ROWS`, fractions of the image's height from its top.
"""
FLIP = np.diag([1.0, -1.0, -1.0, 1.0])
"""From the IMU's axes (x forward, y right, z down) to ours (x forward, y left, z up)."""
MOST_SKIPPED = 3000
"""Frames of KITTI-360 that SSCBench may have left out one after the other."""
SAME = 2.0
"""Mean difference of grey levels of thumbnails up to which two images are the same."""


def read_rows(path: Path) -> dict[str, Float64[np.ndarray, " n"]]:
    """Return the numbers of a calibration file by name: 'name: numbers' lines, or one line of numbers named ''.

    Raises:
        DataError: naming the line that holds no numbers.
    """
    rows: dict[str, Float64[np.ndarray, " n"]] = {}
    for number, line in enumerate(read_text(path).splitlines(), start=1):
        name, _, values = line.rpartition(":")
        try:
            if values.strip():
                row = np.array([number_of(word) for word in values.split()])
                if name.strip() in rows:
                    raise DataError(f"{path}, line {number}: the line '{name.strip()}' stands twice; keep one")
                rows[name.strip()] = row
        except ValueError as error:
            if name.strip() not in ("calib_time", ""):
                raise DataError(f"{path}, line {number}: the values of '{name}' are no numbers") from error
    return rows


def matrix(path: Path, name: str, shape: tuple[int, int]) -> Float64[np.ndarray, "rows columns"]:
    """Return a matrix of a calibration file; raise DataError if it is missing or has another size."""
    rows = read_rows(path)
    if name not in rows or rows[name].size != shape[0] * shape[1]:
        raise DataError(f"{path}: the line '{name}' of {shape[0] * shape[1]} numbers is missing")
    return rows[name].reshape(shape)


def pose_of(path: Path, name: str) -> Float64[np.ndarray, "4 4"]:
    """Return a pose of a calibration file; raise DataError if it is missing or no rotation."""
    try:
        return rigid(matrix(path, name, (3, 4)), f"the line '{name}'")
    except ValueError as error:
        raise DataError(f"{path}: {error}") from error


def velodyne_pose(calibration: Path) -> Float64[np.ndarray, "4 4"]:
    """Return imu_from_velodyne: through the unrectified camera 0 (kitti360scripts, helpers/project.py)."""
    camera = pose_of(calibration / "calib_cam_to_pose.txt", "image_00")
    return camera @ inverse(pose_of(calibration / "calib_cam_to_velo.txt", ""))


def mounted(calibration: Path, name: str) -> tuple[Camera, Float64[np.ndarray, "4 4"]]:
    """Return a camera (image_00 to image_03) at the size of its files, and its pose imu_from_camera.

    Raises:
        DataError: naming the file and the value that is missing or wrong.
    """
    if name not in RECTIFIED:
        return fisheye(calibration, name), pose_of(calibration / "calib_cam_to_pose.txt", name)
    k, imu_from_camera = rectified(calibration, name)
    return Pinhole(*SIZE, (float(k[0, 0]), float(k[1, 1])), (float(k[0, 2]), float(k[1, 2]))), imu_from_camera


def rectified(calibration: Path, name: str) -> tuple[Float64[np.ndarray, "3 3"], Float64[np.ndarray, "4 4"]]:
    """Return the intrinsics of a rectified camera (image_00, image_01) and its pose imu_from_camera.

    Raises:
        DataError: naming the file and the value that is missing or wrong.
    """
    number, turn = name[-2:], np.eye(4)
    intrinsics = matrix(calibration / "perspective.txt", f"P_rect_{number}", (3, 4))[:, :3]
    turn[:3, :3] = matrix(calibration / "perspective.txt", f"R_rect_{number}", (3, 3))
    try:
        return intrinsics, pose_of(calibration / "calib_cam_to_pose.txt", name) @ inverse(rigid(turn, "R_rect"))
    except ValueError as error:
        raise DataError(f"{calibration / 'perspective.txt'}: {error}") from error


def fisheye(calibration: Path, name: str) -> MEI:
    """Return a fisheye (image_02, image_03) up to the edge of its image circle.

    Raises:
        DataError: naming the file that is missing or wrong.
    """
    path = calibration / f"{name}.yaml"
    try:
        camera = read_kitti360(parse_yaml(read_text(path)), name).cameras[0]
    except ValueError as error:
        raise DataError(f"{path}: {error}") from error
    assert isinstance(camera, MEI)
    return replace(camera, max_angle_deg=LENS_DEG)


def above_car(camera: Camera) -> Bool[Tensor, "height width"]:
    """Return the pixels of a fisheye's image, of any size, that do not show the own car."""
    rows, columns = np.arange(camera.height) + 0.5, np.arange(camera.width) + 0.5
    free = np.interp(rows / camera.height, CAR_ROWS, CAR_FREE)
    return torch.from_numpy(np.abs(columns / camera.width - 0.5) <= free[:, None])


def image_file(root: Path, sequence: str, name: str, number: int) -> Path:
    """Return the file of an image."""
    kind = "data_rect" if name in RECTIFIED else "data_rgb"
    return root / "data_2d_raw" / SEQUENCE.format(sequence) / name / kind / f"{number:010d}.png"


def scan_file(root: Path, sequence: str, number: int) -> Path:
    """Return the file of a scan of the Velodyne."""
    return root / "data_3d_raw" / SEQUENCE.format(sequence) / "velodyne_points" / "data" / f"{number:010d}.bin"


def read_numbered_poses(path: Path) -> tuple[Int64[np.ndarray, " F"], Float64[np.ndarray, "F 4 4"]]:
    """Return frame numbers and world_from_imu of a `poses.txt`; frames without a line have no pose.

    Raises:
        DataError: naming the file and the line that is no pose, or has the number of another.
    """
    rows, poses = read_matrices(path, ("frame",))
    numbers: dict[int, str] = {}
    for row in rows:
        if not re.fullmatch("[0-9]{1,15}", row.keys[0]) or int(row.keys[0]) in numbers:
            raise DataError(f"{row.where}: '{row.keys[0]}' is no number of a frame, or that of another line")
        numbers[int(row.keys[0])] = row.where
    return np.array(list(numbers), np.int64), poses


def thumbnail(path: Path) -> UInt8[np.ndarray, "12 44"]:
    """Return a small grey image, by which equal images are found."""
    return cv2.resize(decode(path, cv2.IMREAD_REDUCED_GRAYSCALE_8), (44, 12), interpolation=cv2.INTER_AREA)


def match_frames(theirs: Sequence[Path], ours: Sequence[Path], title: str) -> list[int]:
    """Return for each image of `theirs` the index of the same image in `ours`; both are in the order of time.

    Every image is read once at most.

    Raises:
        DataError: naming the first image that is not found.
    """
    found: list[int] = []
    window: deque[tuple[int, UInt8[np.ndarray, "12 44"]]] = deque()
    ahead = _thumbnails(ours)
    with Progress(title, len(theirs), "images") as progress:
        for path in theirs:
            place = _nearest(thumbnail(path), window, ahead)
            if place is None:
                where = ours[0].parent if ours else "KITTI-360"
                raise DataError(f"{path}: the same image is not in {where}, or not among its next {MOST_SKIPPED}")
            found.append(window[place][0])
            for _ in range(place + 1):
                window.popleft()
            progress.advance()
    return found


def _nearest(
    wanted: UInt8[np.ndarray, "12 44"], window: deque[tuple[int, np.ndarray]], ahead: Iterator[tuple[int, np.ndarray]]
) -> int | None:
    """Return the place in the window of the image that is wanted, None if it is not near.

    Neighbours of a car that hardly moves look the same too: the search ends where the difference grows again. The
    window is filled from the images `ahead` as far as it is looked at.
    """
    best, place = SAME, None
    for number in range(MOST_SKIPPED + 1):
        if number == len(window):
            if (image := next(ahead, None)) is None:
                break
            window.append(image)
        difference = float(np.abs(window[number][1] - wanted.astype(np.int16)).mean())
        if difference < best:
            best, place = difference, number
        elif place is not None:
            break
    return place


def _thumbnails(paths: Sequence[Path]) -> Iterator[tuple[int, UInt8[np.ndarray, "12 44"]]]:
    for index, path in enumerate(paths):
        yield index, thumbnail(path)
