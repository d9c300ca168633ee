"""Reader of OpenCV's FileStorage YAML and of ROS's camera_info, which has the same keys."""

import re
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float64
from torch import Tensor

from omniocc.camera.calibration.fields import (
    Calibration,
    ego_from_first,
    mapping,
    naming,
    number,
    pose,
    read_mask_of,
    required,
    row,
    single,
    size,
    whole,
)
from omniocc.camera.calibration.ocamcalib import drop_count
from omniocc.camera.models.double_sphere import DoubleSphere
from omniocc.camera.models.eucm import EUCM
from omniocc.camera.models.kannala_brandt import KannalaBrandt
from omniocc.camera.models.mei import MEI
from omniocc.camera.models.ocam import OCam
from omniocc.camera.models.pinhole import Pinhole
from omniocc.camera.pose import LEVEL_FORWARD, invert_pose, rigid_pose
from omniocc.camera.protocol import Camera

FISHEYE = ("equidistant", "fisheye", "kannala_brandt")


def read_opencv(content: dict[str, Any], name: str) -> Calibration:
    """Return one camera from `camera_matrix`, `dist_coeffs` (`distortion_coefficients`) and the image size.

    The size is `resolution`, or `image_width` and `image_height`. Four coefficients are `cv2.fisheye`'s
    (Kannala-Brandt) unless `distortion_model` or `fisheye_model` names another one; `cv2.calibrateCamera` writes five
    or more.

    Raises:
        ValueError: naming the key that is missing, or a distortion that no model supports.
    """
    matrix = row(content, 9, "camera_matrix")
    fx, skew, cx, zero, fy, cy, *last = matrix
    if skew != 0 or zero != 0 or last != [0, 0, 1]:
        raise ValueError(f"camera_matrix is {matrix}; it must be [fx, 0, cx, 0, fy, cy, 0, 0, 1]")
    if "image_width" in content or "image_height" in content:
        width, height = whole(content, "image_width"), whole(content, "image_height")
    else:
        required(content, "resolution", "image_width")
        width, height = size(content, "resolution")
    coefficients = row(content, None, "dist_coeffs", "distortion_coefficients")
    if _is_fisheye(content, len(coefficients)):
        if len(coefficients) != 4:
            raise ValueError(f"a fisheye has 4 coefficients, this file holds {len(coefficients)}: {coefficients}")
        return single(KannalaBrandt(width, height, (fx, fy), (cx, cy), tuple(coefficients), 180.0), name)
    if any(coefficients):
        raise ValueError(
            f"dist_coeffs are {coefficients}: a pinhole with distortion is not supported; undistort the images "
            "(cv2.undistort) and set the coefficients to 0, or calibrate with cv2.fisheye"
        )
    return single(Pinhole(width, height, (fx, fy), (cx, cy)), name)


def _is_fisheye(content: dict[str, Any], count: int) -> bool:
    if "fisheye_model" in content:
        return number(content, "fisheye_model") != 0
    if "distortion_model" in content:
        return str(content["distortion_model"]).lower() in FISHEYE
    return count == 4


def read_kalibr(content: dict[str, Any]) -> Calibration:
    """Return cameras cam0, cam1, ... with the poses of their chain `T_cn_cnm1`.

    The file has no vehicle frame. The ego frame looks forward as cam0 does, which is taken as level, and its origin is
    the mean position of the cameras.

    Raises:
        ValueError: naming the camera and the key.
    """
    names = [f"cam{index}" for index in range(sum(is_camera(*item) for item in content.items()))]
    cameras, poses, cam0 = [], [], torch.eye(4, dtype=torch.float64)
    for name in names:
        entry = required(content, name)
        with naming(name):
            cameras.append(_kalibr_camera(mapping(entry, "its entry")))
            previous_from_this = invert_pose(pose(required(entry, "T_cn_cnm1"), "T_cn_cnm1")) if poses else cam0
            poses.append(poses[-1] @ previous_from_this if poses else cam0)
    return Calibration(tuple(cameras), ego_from_first(torch.stack(poses)), tuple(names), None)


def is_camera(key: Any, entry: Any) -> bool:
    """Return whether an entry of a file of Kalibr is a camera; others may stand beside them, such as a date."""
    return bool(re.fullmatch(r"cam\d+", str(key))) or (isinstance(entry, dict) and "camera_model" in entry)


def _kalibr_camera(entry: dict[str, Any]) -> Camera:
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
        return MEI(width, height, (fx, fy), (cx, cy), xi, coefficients or (0.0, 0.0, 0.0, 0.0), max_angle_deg=180.0)
    if lens == "ds" and undistorted:
        xi, alpha, fx, fy, cx, cy = row(entry, 6, "intrinsics")
        return DoubleSphere(width, height, (fx, fy), (cx, cy), xi, alpha, max_angle_deg=180.0)
    if lens == "eucm" and undistorted:
        alpha, beta, fx, fy, cx, cy = row(entry, 6, "intrinsics")
        return EUCM(width, height, (fx, fy), (cx, cy), alpha, beta, max_angle_deg=180.0)
    raise ValueError(
        f"camera_model {lens} with distortion_model {distortion} is not supported; supported are "
        "pinhole-equidistant, pinhole-none, omni-radtan, omni-none, ds-none and eucm-none: calibrate with one of them"
    )


def read_omnimvs(content: dict[str, Any], folder: Path) -> Calibration:
    """Return cameras from `poly`, `inv_poly`, `center`, `affine`, `image_size`, `max_fov` and `pose`.

    A pose is a rotation vector and a position in metres, camera to rig; the rig frame (x right, y down, z forward) is
    rotated into the ego frame. An `invalid_mask` is not 0 where the image is unusable. Published folders name masks and
    hold none of them; the cameras then have none.

    Raises:
        ValueError: naming the camera and the key, or the mask that is not there although another camera's is.
    """
    cameras, poses, names, masks = [], [], [], []
    for index, entry in enumerate(required(content, "cameras")):
        name = f"cam{mapping(entry, f'cameras[{index}]').get('cam_id', index + 1)}"
        with naming(name):
            cameras.append(_omnimvs_camera(entry))
            poses.append(_omnimvs_pose(row(entry, 6, "pose")))
            masks.append(_omnimvs_mask(folder / str(entry.get("invalid_mask", "")), cameras[-1]))
        names.append(name)
    for name, mask, entry in zip(names, masks, content["cameras"], strict=True):
        if mask is None and "invalid_mask" in entry and any(other is not None for other in masks):
            raise ValueError(f"{name}: invalid_mask {folder / str(entry['invalid_mask'])} does not exist")
    if not cameras:
        raise ValueError("cameras is an empty list; is the file whole?")
    kept = None if all(mask is None for mask in masks) else tuple(masks)
    return Calibration(tuple(cameras), torch.stack(poses), tuple(names), kept)


def _omnimvs_camera(entry: dict[str, Any]) -> OCam:
    if entry.get("model", "ocam") != "ocam":
        raise ValueError(f"model is {entry['model']!r}; an OmniMVS config holds ocam only")
    height, width = size(entry, "image_size")
    center_row, center_column = row(entry, 2, "center")
    return OCam(
        width,
        height,
        (center_column, center_row),
        drop_count("poly", row(entry, None, "poly")),
        drop_count("inv_poly", row(entry, None, "inv_poly")),
        tuple(row(entry, 3, "affine")),
        max_angle_deg=number(entry, "max_fov") / 2,
    )


def _omnimvs_pose(values: list[float]) -> Float64[Tensor, "4 4"]:
    ego_from_rig = torch.tensor(LEVEL_FORWARD, dtype=torch.float64)
    rig_from_camera = torch.from_numpy(cv2.Rodrigues(np.array(values[:3]))[0])
    return rigid_pose(ego_from_rig @ rig_from_camera, ego_from_rig @ torch.tensor(values[3:], dtype=torch.float64))


def _omnimvs_mask(file: Path, camera: OCam) -> Bool[Tensor, "_ _"] | None:
    if not file.is_file():
        return None
    return ~read_mask_of("invalid_mask", file, camera)
