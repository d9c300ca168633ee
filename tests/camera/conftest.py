"""Cameras with known pixels: real calibrations and vectors computed independently in float64."""

import json
import math
from pathlib import Path

import pytest

from omniocc.camera import EUCM, MEI, DoubleSphere, FTheta, KannalaBrandt, OCam, RadialPolynomial

FOLDER = Path(__file__).parent


def build(entry, exact=False, max_angle_deg=180.0):
    """Return the camera of one entry of camera_fixtures.json; `exact` leaves out OCam's inverse polynomial."""
    size = (entry["width"], entry["height"])
    if entry["model"] == "ocam":
        row, column = entry["center_row_col"]
        inverse = () if exact else tuple(entry["inv_poly"])
        angle = min(entry["max_fov_deg"] / 2, max_angle_deg)
        return OCam(*size, (column, row), tuple(entry["poly"]), inverse, tuple(entry["affine_cde"]), angle)
    if entry["model"] == "mei":
        focal, center = (entry["gamma1"], entry["gamma2"]), (entry["u0"], entry["v0"])
        distortion = tuple(entry[key] for key in ("k1", "k2", "p1", "p2"))
        return MEI(*size, focal, center, entry["xi"], distortion, max_angle_deg)
    if entry["model"] == "ftheta":
        by_radius = entry["reference_poly"] == "PIXELDIST_TO_ANGLE"
        forward = () if by_radius else tuple(entry["angle_to_pixeldist_poly"])
        backward = tuple(entry["pixeldist_to_angle_poly"]) if by_radius else ()
        angle = min(math.degrees(entry["max_angle"]), max_angle_deg)
        return FTheta(*size, tuple(entry["principal_point"]), forward, backward, tuple(entry["linear_cde"]), angle)
    if entry["model"] == "radial":
        center = (entry["cx_offset"] + size[0] / 2 - 0.5, entry["cy_offset"] + size[1] / 2 - 0.5)
        return RadialPolynomial(*size, tuple(entry["k"]), center, entry["aspect_ratio"], max_angle_deg)
    focal, center = (entry["fx"], entry["fy"]), (entry["cx"], entry["cy"])
    if entry["model"] == "kb4":
        return KannalaBrandt(*size, focal, center, tuple(entry["k"]), max_angle_deg)
    if entry["model"] == "ds":
        return DoubleSphere(*size, focal, center, entry["xi"], entry["alpha"], max_angle_deg)
    return EUCM(*size, focal, center, entry["alpha"], entry["beta"], max_angle_deg)


@pytest.fixture(scope="session")
def known():
    """Return the content of camera_fixtures.json."""
    return json.loads((FOLDER / "camera_fixtures.json").read_text())


@pytest.fixture(scope="session")
def build_camera():
    """Return the function `build`."""
    return build


@pytest.fixture(scope="session")
def corners():
    """Return the content of surround_view_corners.json."""
    return json.loads((FOLDER / "surround_view_corners.json").read_text())
