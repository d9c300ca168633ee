import math

import cv2
import numpy as np
import pytest
import torch

from omniocc.camera import KannalaBrandt

LEFT = KannalaBrandt(960, 640, (303.34, 322.3), (486.5, 323.9), (-0.0355, -0.01985, 0.02608, -0.009718), 180.0)


def test_agrees_with_opencv_in_front(known, build_camera):
    rng = np.random.default_rng(0)
    points = rng.uniform(-3, 3, (300, 3))
    points[:, 2] = rng.uniform(0.3, 3, 300)
    for name in ("svs_front", "basalt_test_kb4", "euroc_kb"):
        entry = known["cameras"][name]
        matrix = np.array([[entry["fx"], 0, entry["cx"]], [0, entry["fy"], entry["cy"]], [0, 0, 1]])
        k = np.array(entry["k"])
        expected, _ = cv2.fisheye.projectPoints(points[:, None], np.zeros(3), np.zeros(3), matrix, k)
        pixels, _ = build_camera(entry).project(torch.from_numpy(points))
        np.testing.assert_allclose(pixels.numpy(), expected[:, 0], rtol=0, atol=1e-9)


@pytest.mark.parametrize(
    ("name", "limit_deg"), [("svs_left", 86.931), ("svs_back", 108.9), ("basalt_test_kb4", 112.06)]
)
def test_ends_where_the_polynomial_turns(name, limit_deg, known, build_camera):
    camera = build_camera(known["cameras"][name])
    assert math.degrees(camera.limit_rad) == pytest.approx(limit_deg, abs=0.02)
    assert math.degrees(build_camera(known["cameras"]["svs_front"]).limit_rad) == pytest.approx(180)


def test_rim_is_found_to_a_pixel_but_not_passed():
    edge = torch.tensor([math.sin(LEFT.limit_rad), 0, math.cos(LEFT.limit_rad)], dtype=torch.float64)
    rim, _ = LEFT.project(edge)
    assert LEFT.unproject(rim - rim.new_tensor([1e-6, 0]))[1]
    assert not LEFT.unproject(rim + rim.new_tensor([1e-6, 0]))[1]
    ray, _ = LEFT.unproject(rim)
    torch.testing.assert_close(LEFT.project(ray)[0], rim, rtol=0, atol=1e-6)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"focal_px": (0.0, 1.0)}, "focal_px is 0.0"),
        ({"coefficients": (0.0, 0.0)}, "coefficients is .* 4 numbers"),
        ({"coefficients": (0.0, 0.0, math.nan, 0.0)}, "coefficients is nan"),
        ({"max_angle_deg": 181.0}, "ends at 180"),
    ],
)
def test_wrong_parameters_are_named(change, message):
    good = {"width": 4, "height": 4, "focal_px": (1.0, 1.0), "center_px": (1.5, 1.5)}
    good |= {"coefficients": (0.0, 0.0, 0.0, 0.0), "max_angle_deg": 90.0}
    with pytest.raises(ValueError, match=message):
        KannalaBrandt(**(good | change))
