"""Reader of OpenCV's FileStorage YAML and of ROS's camera_info, which has the same keys."""

from typing import Any

from omniocc.camera.calibration.fields import Calibration, number, required, row, single, size, whole
from omniocc.camera.models.kannala_brandt import KannalaBrandt
from omniocc.camera.models.pinhole import Pinhole

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
