"""Reader of Kalibr's camchain YAML."""

import re
from typing import Any

import torch

from omniocc.camera.calibration.fields import Calibration, ego_from_first, mapping, naming, pose, required, row, size
from omniocc.camera.models.double_sphere import DoubleSphere
from omniocc.camera.models.eucm import EUCM
from omniocc.camera.models.kannala_brandt import KannalaBrandt
from omniocc.camera.models.mei import MEI
from omniocc.camera.models.pinhole import Pinhole
from omniocc.camera.pose import invert_pose
from omniocc.camera.protocol import Camera


def read_kalibr(content: dict[str, Any]) -> Calibration:
    """Return cameras cam0, cam1, ... with the poses of their chain `T_cn_cnm1`.

    The file has no vehicle frame: forward of the ego frame is that of cam0, taken as level, and its origin is the mean
    position of the cameras.

    Raises:
        ValueError: naming the camera and the key.
    """
    names = [f"cam{index}" for index in range(sum(is_camera(*item) for item in content.items()))]
    cameras, poses, cam0 = [], [], torch.eye(4, dtype=torch.float64)
    for name in names:
        entry = required(content, name)
        with naming(name):
            cameras.append(_camera(mapping(entry, "its entry")))
            previous_from_this = invert_pose(pose(required(entry, "T_cn_cnm1"), "T_cn_cnm1")) if poses else cam0
            poses.append(poses[-1] @ previous_from_this if poses else cam0)
    return Calibration(tuple(cameras), ego_from_first(torch.stack(poses)), tuple(names), None)


def is_camera(key: Any, entry: Any) -> bool:
    """Return whether an entry of a file of Kalibr is a camera; others may stand beside them, such as a date."""
    return bool(re.fullmatch(r"cam\d+", str(key))) or (isinstance(entry, dict) and "camera_model" in entry)


def _camera(entry: dict[str, Any]) -> Camera:
    lens, distortion = str(required(entry, "camera_model")), str(required(entry, "distortion_model"))
    width, height = size(entry, "resolution")
    coefficients = tuple(row(entry, 0 if distortion == "none" else 4, "distortion_coeffs"))
    undistorted = not any(coefficients)
    if lens == "pinhole":
        fx, fy, cx, cy = row(entry, 4, "intrinsics")
        if distortion == "equidistant":
            return KannalaBrandt(width, height, (fx, fy), (cx, cy), coefficients, 180.0)
        if undistorted:
            return Pinhole(width, height, (fx, fy), (cx, cy))
    if lens == "omni" and (distortion == "radtan" or undistorted):
        xi, fx, fy, cx, cy = row(entry, 5, "intrinsics")
        return MEI(width, height, (fx, fy), (cx, cy), xi, coefficients or (0.0, 0.0, 0.0, 0.0), 180.0)
    if lens == "ds" and undistorted:
        xi, alpha, fx, fy, cx, cy = row(entry, 6, "intrinsics")
        return DoubleSphere(width, height, (fx, fy), (cx, cy), xi, alpha, 180.0)
    if lens == "eucm" and undistorted:
        alpha, beta, fx, fy, cx, cy = row(entry, 6, "intrinsics")
        return EUCM(width, height, (fx, fy), (cx, cy), alpha, beta, 180.0)
    raise ValueError(
        f"camera_model {lens} with distortion_model {distortion} is not supported; supported are "
        "pinhole-equidistant, pinhole-none, omni-radtan, omni-none, ds-none and eucm-none: calibrate with one of them"
    )
