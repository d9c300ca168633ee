"""Limits of the models that project from a sphere, and the same lens in two models."""

import math

import pytest
import torch

from omniocc.camera import EUCM, MEI, DoubleSphere
from omniocc.camera.ops.angle import pinhole_bound


def ray(angle_deg):
    return torch.tensor([math.sin(math.radians(angle_deg)), 0, math.cos(math.radians(angle_deg))], dtype=torch.float64)


def test_one_lens_in_three_models_agrees_to_about_a_pixel(known, build_camera):
    brandt, double, unified = (build_camera(known["cameras"][f"euroc_{name}"]) for name in ("kb", "ds", "eucm"))
    u, v = torch.meshgrid(torch.arange(0, 752, 8.0), torch.arange(0, 480, 8.0), indexing="xy")
    pixels = torch.stack([u, v], -1).double()
    rays, _ = brandt.unproject(pixels)
    for other in (double, unified):
        error = (other.project(rays)[0] - pixels).norm(dim=-1)
        assert error.max() < 1.2, "in a corner of the image"
        assert error.mean() < 0.6


def test_double_sphere_ends_at_the_papers_bound():
    camera = DoubleSphere(9000, 9000, (100.0, 100.0), (4500.0, 4500.0), 0.2, 0.7, 180.0)
    w1 = 0.3 / 0.7
    end_deg = math.degrees(math.acos(-(w1 + 0.2) / math.sqrt(2 * w1 * 0.2 + 0.04 + 1)))
    assert camera.project(ray(end_deg - 0.01))[1]
    assert not camera.project(ray(end_deg + 0.01))[1]


def test_eucm_ends_where_its_pinhole_does():
    camera = EUCM(9000, 9000, (100.0, 100.0), (4500.0, 4500.0), 0.6, 1.1, 180.0)
    w = pinhole_bound(0.6)
    # z = -w d with d^2 = beta r^2 + z^2
    end_deg = 180 - math.degrees(math.atan2(math.sqrt(1 / w**2 - 1), math.sqrt(1.1)))
    assert camera.project(ray(end_deg - 0.01))[1]
    assert not camera.project(ray(end_deg + 0.01))[1]


def test_mei_ends_where_the_sphere_occludes_itself():
    camera = MEI(9000, 9000, (500.0, 500.0), (4500.0, 4500.0), 2.2134047507854890, (0.0, 0.0, 0.0, 0.0), 180.0)
    assert camera.project(ray(116.8))[1]
    assert not camera.project(ray(116.9))[1]


def test_mei_ends_where_its_distortion_turns():
    camera = MEI(900, 900, (300.0, 300.0), (449.5, 449.5), 1.0, (-0.5, 0.0, 0.0, 0.0), 180.0)
    radius = math.sqrt(1 / 1.5)  # of r - r^3 / 2
    end_deg = math.degrees(2 * math.atan(radius))  # xi = 1: the plane is stereographic
    assert camera.project(ray(end_deg - 0.01))[1]
    assert not camera.project(ray(end_deg + 0.01))[1]


def test_without_mirror_mei_and_eucm_are_pinholes():
    points = torch.tensor([[0.3, -0.2, 1], [2, 1, 4]], dtype=torch.float64)
    expected = points[:, :2] / points[:, 2:] * 50 + 31.5
    for camera in (
        MEI(64, 64, (50.0, 50.0), (31.5, 31.5), 0.0, (0.0, 0.0, 0.0, 0.0), 180.0),
        EUCM(64, 64, (50.0, 50.0), (31.5, 31.5), 0.0, 1.0, 180.0),
        DoubleSphere(64, 64, (50.0, 50.0), (31.5, 31.5), 0.0, 0.0, 180.0),
    ):
        pixels, valid = camera.project(points)
        torch.testing.assert_close(pixels, expected)
        assert valid.all()
        assert not camera.project(ray(91))[1]


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: DoubleSphere(4, 4, (1.0, 1.0), (1.5, 1.5), -1.0, 0.5, 90.0), "xi is -1.0"),
        (lambda: DoubleSphere(4, 4, (1.0, 1.0), (1.5, 1.5), 0.0, 1.1, 90.0), "alpha is 1.1"),
        (lambda: EUCM(4, 4, (1.0, 1.0), (1.5, 1.5), -0.1, 1.0, 90.0), "alpha is -0.1"),
        (lambda: EUCM(4, 4, (1.0, 1.0), (1.5, 1.5), 0.5, 0.0, 90.0), "beta is 0.0"),
        (lambda: MEI(4, 4, (1.0, 1.0), (1.5, 1.5), -0.1, (0.0, 0.0, 0.0, 0.0), 90.0), "xi is -0.1"),
    ],
)
def test_error_names_wrong_parameters(build, message):
    with pytest.raises(ValueError, match=message):
        build()
