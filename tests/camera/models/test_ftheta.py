"""Literal values of `camera_fixtures.json`.

Pixels are of mpmath with 40 digits, rays of the class of NVIDIA's NCore 19.8.3 in float64 with 30 Newton steps; the
pixels of that class differ from mpmath's by at most 3e-13 px.
"""

import dataclasses
import math

import pytest
import torch

from omniocc.camera import FTheta, RadialPolynomial
from omniocc.camera.miscalibrated import with_focal_factor
from omniocc.camera.models.mirrored import mirrored

NAMES = ("ncore_sample", "driveworks_sample", "ftheta_wide")


@pytest.mark.parametrize("name", NAMES)
def test_pixels_and_rays_are_those_of_other_code(name, known, build_camera):
    entry = known["cameras"][name]
    camera = build_camera(entry)
    pixels, valid = camera.project(3.7 * torch.tensor(known["points"], dtype=torch.float64))
    for pixel, seen, expected in zip(pixels.tolist(), valid.tolist(), entry["vec"], strict=True):
        if expected is None:
            assert not seen
            continue
        assert pixel == pytest.approx(expected, abs=1e-6, rel=0)
        assert seen == (-0.5 <= expected[0] <= camera.width - 0.5 and -0.5 <= expected[1] <= camera.height - 0.5)
    known_rays = torch.tensor(entry["rays"], dtype=torch.float64)
    rays, valid = camera.unproject(known_rays[:, :2])
    assert torch.equal(valid, known_rays[:, 4] >= math.cos(entry["max_angle"]))
    torch.testing.assert_close(rays[valid], known_rays[valid, 2:], rtol=0, atol=1e-11)


def test_a_lens_is_the_same_from_either_polynomial():
    # straight lines, which are inverse to each other without rounding
    center, linear = (320.0, 240.0), (1.1, 0.02, -0.03)
    radius = FTheta(640, 480, center, (0.0, 300.0), (), linear, 120.0)
    angle = FTheta(640, 480, center, (), (0.0, 1 / 300), linear, 120.0)
    points = torch.randn(500, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    (by_radius, seen), (by_angle, also_seen) = radius.project(points), angle.project(points)
    assert 20 < seen.sum() < 480
    assert torch.equal(seen, also_seen)
    torch.testing.assert_close(by_radius[seen], by_angle[seen], rtol=0, atol=1e-9)
    x, y, z = 0.3, -0.4, 1.2
    offset = 300 * math.atan2(0.5, z) / 0.5 * torch.tensor([1.1 * x + 0.02 * y, -0.03 * x + y], dtype=torch.float64)
    pixel, _ = angle.project(torch.tensor([x, y, z], dtype=torch.float64))
    torch.testing.assert_close(pixel, offset + torch.tensor(center, dtype=torch.float64), rtol=0, atol=1e-9)


def test_without_shear_it_is_the_radial_polynomial():
    inner = (339.7, -32.0, 48.3, -7.2)
    woodscape = RadialPolynomial(1280, 966, inner, (643.4, 479.3), 1.0, 100.0)
    camera = FTheta(1280, 966, (643.4, 479.3), (0.0, *inner), (), (1.0, 0.0, 0.0), 100.0)
    points = torch.randn(300, 3, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    torch.testing.assert_close(camera.project(points), woodscape.project(points), rtol=0, atol=1e-9)


def test_a_polynomial_that_turns_ends_the_model():
    # r = 300 theta - 100 theta^2 turns at 1.5 rad; theta = r / 300 - r^2 / 300^2 turns at 150 px and 0.25 rad
    forward = FTheta(900, 900, (449.5, 449.5), (0.0, 300.0, -100.0), (), (1.0, 0.0, 0.0), 180.0)
    assert forward.limit_rad == pytest.approx(1.5)
    backward = FTheta(900, 900, (449.5, 449.5), (), (0.0, 1 / 300, -1 / 300**2), (1.0, 0.0, 0.0), 180.0)
    assert backward.limit_rad == pytest.approx(0.25)
    for radius, seen in ((149.9, True), (150.1, False)):
        assert bool(backward.unproject(torch.tensor([449.5 + radius, 449.5], dtype=torch.float64))[1]) is seen
    points = torch.tensor([[math.sin(a), 0, math.cos(a)] for a in (0.2499, 0.2501)], dtype=torch.float64)
    assert backward.project(points)[1].tolist() == [True, False]


@pytest.mark.parametrize("name", NAMES)
def test_focal_factor_and_mirror(name, known, build_camera):
    camera = build_camera(known["cameras"][name])
    point = torch.tensor([0.3, -0.2, 1.0], dtype=torch.float64)
    center = torch.tensor(camera.center_px, dtype=torch.float64)
    pixel, _ = camera.project(point)
    longer, _ = with_focal_factor(camera, 1.05).project(point)
    torch.testing.assert_close(longer - center, 1.05 * (pixel - center), rtol=0, atol=1e-9)
    flipped, _ = mirrored(camera).project(point * point.new_tensor([-1.0, 1.0, 1.0]))
    assert flipped.tolist() == pytest.approx([camera.width - 1 - float(pixel[0]), float(pixel[1])], abs=1e-9)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"angle_to_pixeldist": ()}, "one must be"),
        ({"pixeldist_to_angle": (0.0, 0.002)}, "one must be"),
        ({"angle_to_pixeldist": (3.0, 400.0)}, "angle_to_pixeldist is .*begin with 0"),
        ({"angle_to_pixeldist": (0.0,)}, "angle_to_pixeldist is .*slope"),
        ({"angle_to_pixeldist": (0.0, -400.0)}, r"angle_to_pixeldist\[1\] is -400.0.*above 0"),
        ({"angle_to_pixeldist": (), "pixeldist_to_angle": (0.0, 0.0)}, r"pixeldist_to_angle\[1\] is 0.0.*above 0"),
        ({"linear_cde": (0.0, 1.0, 1.0)}, "linear_cde is"),
        ({"linear_cde": (1.0, 0.0)}, "linear_cde is .*3 numbers"),
        ({"max_angle_deg": 220.0}, "max_angle_deg is 220"),
    ],
)
def test_wrong_parameters_are_named(change, message, known, build_camera):
    with pytest.raises(ValueError, match=message):
        dataclasses.replace(build_camera(known["cameras"]["ncore_sample"]), **change)
