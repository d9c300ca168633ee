import math

import cv2
import numpy as np
import pytest
import torch

from omniocc.camera import Equidistant

CAMERA = Equidistant(512, 288, 154.4, (255.5, 143.5), 180.0)
NARROW = Equidistant(512, 288, 154.4, (255.5, 143.5), 95.0)


def polar(theta_deg, phi_deg, dtype=torch.float64):
    theta, phi = math.radians(theta_deg), math.radians(phi_deg)
    xyz = [math.sin(theta) * math.cos(phi), math.sin(theta) * math.sin(phi), math.cos(theta)]
    return torch.tensor(xyz, dtype=dtype)


@pytest.mark.parametrize(
    ("theta_deg", "phi_deg", "u", "v"),
    [
        (0, 0, 255.5, 143.5),
        (45, 0, 255.5 + 154.4 * math.pi / 4, 143.5),
        (90, 0, 255.5 + 154.4 * math.pi / 2, 143.5),
        (90, 180, 255.5 - 154.4 * math.pi / 2, 143.5),
        (30, 90, 255.5, 143.5 + 154.4 * math.pi / 6),
        (94.9, 180, 255.5 - 154.4 * math.radians(94.9), 143.5),
    ],
)
def test_radius_is_focal_times_angle(theta_deg, phi_deg, u, v):
    pixel, valid = NARROW.project(3.7 * polar(theta_deg, phi_deg))
    torch.testing.assert_close(pixel, torch.tensor([u, v], dtype=torch.float64), rtol=0, atol=1e-10)
    assert valid


def test_agrees_with_opencv_in_front():
    rng = np.random.default_rng(0)
    points = rng.uniform(-3, 3, (200, 3))
    points[:, 2] = rng.uniform(0.05, 3, 200)
    matrix = np.array([[154.4, 0, 255.5], [0, 154.4, 143.5], [0, 0, 1]])
    expected, _ = cv2.fisheye.projectPoints(points[:, None], np.zeros(3), np.zeros(3), matrix, np.zeros(4))
    pixels, _ = CAMERA.project(torch.from_numpy(points))
    np.testing.assert_allclose(pixels.numpy(), expected[:, 0], rtol=0, atol=1e-9)


@pytest.mark.parametrize(("dtype", "atol"), [(torch.float32, 2e-6), (torch.float64, 1e-14)])
def test_ray_to_pixel_to_ray_at_every_angle(dtype, atol):
    angles = [0, 1e-9, 1e-5, 1e-3, 1, 45, 89.9999, 90, 90.0001, 95, 120, 170, 179]
    rays = torch.stack([polar(t, p, dtype) for t in angles for p in (-170, -90, 0, 33, 90, 180)])
    pixels, _ = CAMERA.project(5 * rays)
    back, valid = CAMERA.unproject(pixels)
    assert valid.all()
    assert pixels.dtype == back.dtype == dtype
    torch.testing.assert_close(back, rays, rtol=0, atol=atol)


@pytest.mark.parametrize(("dtype", "atol"), [(torch.float32, 2e-4), (torch.float64, 1e-10)])
def test_pixel_to_ray_to_pixel(dtype, atol):
    u, v = torch.meshgrid(torch.arange(512.0), torch.arange(288.0), indexing="xy")
    pixels = torch.stack([u, v], -1).to(dtype)
    pixels[0, 0] = torch.tensor([255.5, 143.5])
    pixels[0, 1] = torch.tensor([255.5 + 1e-5, 143.5])
    rays, valid = NARROW.unproject(pixels)
    torch.testing.assert_close(rays.norm(dim=-1), torch.ones_like(pixels[..., 0]))
    back, visible = NARROW.project(7 * rays)
    torch.testing.assert_close(back, pixels, rtol=0, atol=atol)
    off_limit = (pixels - 255.5).new_tensor([255.5, 143.5])
    angle = (pixels - off_limit).norm(dim=-1) / 154.4
    clear = (angle - math.radians(95)).abs() > 1e-5
    assert torch.equal(valid[clear], visible[clear])
    assert torch.equal(valid[clear], angle[clear] <= math.radians(95))


def test_limits_of_validity():
    inside, outside = polar(94.9999, 170), polar(95.0001, 170)
    assert NARROW.project(inside)[1]
    assert not NARROW.project(outside)[1]
    assert not NARROW.unproject(NARROW.project(outside)[0])[1]
    below = polar(80, 90)
    assert not NARROW.project(below)[1], "outside the image, though within the lens"
    edge = torch.tensor([[-0.5, 10.0], [511.5, 287.5]], dtype=torch.float64)
    inwards = torch.tensor([[1e-9, 0], [-1e-9, -1e-9]], dtype=torch.float64)
    assert CAMERA.project(CAMERA.unproject(edge + inwards)[0])[1].all()
    assert not CAMERA.project(CAMERA.unproject(edge - inwards)[0])[1].any()


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_no_nan_where_the_formula_has_none(dtype):
    rows = [[0, 0, 1], [0, 0, -1], [0, 0, 0], [1e-30, 0, 1], [1e-30, 0, -1], [1e-12, -1e-12, 2], [0, 0, 1e-12]]
    points = torch.tensor(rows, dtype=dtype, requires_grad=True)
    pixels, valid = CAMERA.project(points)
    pixels.sum().backward()
    assert pixels.isfinite().all()
    assert points.grad.isfinite().all()
    assert valid.tolist() == [True, False, False, True, False, True, True]
    pixels = torch.tensor([[255.5, 143.5], [255.5 + 1e-20, 143.5]], dtype=dtype, requires_grad=True)
    rays, _ = CAMERA.unproject(pixels)
    rays.sum().backward()
    assert rays.isfinite().all()
    torch.testing.assert_close(pixels.grad, torch.full_like(pixels, 1 / 154.4))


def test_gradients():
    points = torch.stack([*(2 * polar(t, 40) for t in (1e-9, 1e-3, 30, 90, 130)), polar(0, 0), 3 * polar(0, 0)])
    points.requires_grad_()
    assert torch.autograd.gradcheck(lambda p: CAMERA.project(p)[0], points)
    pixels = torch.tensor([[255.5, 143.5], [255.6, 143.5], [20.0, 200.0]], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda p: CAMERA.unproject(p)[0], pixels)


def test_any_batch_shape():
    assert CAMERA.project(torch.rand(2, 5, 3))[0].shape == (2, 5, 2)
    assert CAMERA.project(torch.rand(3))[1].shape == ()
    assert CAMERA.unproject(torch.rand(0, 2))[0].shape == (0, 3)


def test_resized_sees_the_same_ray_at_the_scaled_pixel():
    small = NARROW.resized(256, 144)
    pixels = torch.rand(50, 2, dtype=torch.float64) * torch.tensor([511.0, 287.0])
    rays, _ = NARROW.unproject(pixels)
    torch.testing.assert_close(small.unproject((pixels + 0.5) / 2 - 0.5)[0], rays, rtol=0, atol=1e-12)
    stretched, (rays, valid) = NARROW.resized(256, 150), NARROW.unproject(pixels)
    moved = (pixels + 0.5) * torch.tensor([256 / 512, 150 / 288], dtype=torch.float64) - 0.5
    found, still = stretched.unproject(moved)
    assert torch.equal(still, valid)
    torch.testing.assert_close(found[valid], rays[valid], rtol=0, atol=1e-9)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"focal_px": 0.0}, "focal_px is 0.0"),
        ({"focal_px": math.nan}, "focal_px is nan"),
        ({"max_angle_deg": 190.0}, "ends at 180"),
        ({"width": 0}, "width is 0"),
        ({"center_px": (1.0, math.inf)}, "center_px is inf"),
    ],
)
def test_wrong_parameters_are_named(change, message):
    good = {"width": 4, "height": 4, "focal_px": 1.0, "center_px": (1.5, 1.5), "max_angle_deg": 90.0}
    with pytest.raises(ValueError, match=message):
        Equidistant(**(good | change))
