import math

import pytest
import torch

from omniocc.camera import Equirectangular

CAMERA = Equirectangular(360, 90, 45.0, -45.0)


@pytest.mark.parametrize(
    ("point", "u", "v"),
    [
        ((1, 0, 0), 179.5, 44.5),  # forward: middle of the image
        ((0, 2, 0), 89.5, 44.5),  # left of the car: left of the image
        ((0, -2, 0), 269.5, 44.5),
        ((3, 0, 3), 179.5, -0.5),  # 45 degrees up: upper edge
        ((1, 0, -1), 179.5, 89.5),
        ((-1, 0.0, 0), -0.5, 44.5),  # behind, azimuth +pi: left edge
        ((-1, -1e-12, 0), 359.5, 44.5),  # behind, azimuth -pi: right edge
    ],
)
def test_convention(point, u, v):
    pixel, _ = CAMERA.project(torch.tensor(point, dtype=torch.float64))
    torch.testing.assert_close(pixel, torch.tensor([u, v], dtype=torch.float64), rtol=0, atol=1e-9)


def test_rays_follow_the_formula():
    rays = Equirectangular(8, 4, 60.0, -20.0).rays()
    assert rays.shape == (4, 8, 3)
    assert rays.dtype == torch.float32
    for i in range(4):
        for j in range(8):
            azimuth, elevation = math.pi - (j + 0.5) * 2 * math.pi / 8, math.radians(60 - (i + 0.5) * 80 / 4)
            flat = math.cos(elevation)
            expected = [flat * math.cos(azimuth), flat * math.sin(azimuth), math.sin(elevation)]
            torch.testing.assert_close(rays[i, j], torch.tensor(expected))


@pytest.mark.parametrize(("dtype", "atol"), [(torch.float32, 3e-4), (torch.float64, 1e-11)])
def test_round_trip_of_every_pixel(dtype, atol):
    u, v = torch.meshgrid(torch.arange(360.0), torch.arange(90.0), indexing="xy")
    pixels = torch.stack([u, v], -1).to(dtype)
    rays, valid = CAMERA.unproject(pixels)
    back, visible = CAMERA.project(4 * rays)
    assert valid.all()
    assert visible.all()
    torch.testing.assert_close(back, pixels, rtol=0, atol=atol)


def test_poles_and_origin():
    full = Equirectangular(360, 180, 90.0, -90.0)
    points = torch.tensor([[0, 0, 1.0], [0, 0, -1.0], [0, 0, 0]], requires_grad=True)
    pixels, valid = full.project(points)
    pixels.sum().backward()
    assert pixels.isfinite().all()
    assert points.grad.isfinite().all()
    assert pixels[:2, 1].tolist() == pytest.approx([-0.5, 179.5], abs=1e-4)
    assert not valid[2]
    assert not CAMERA.project(points)[1].any()


def test_gradients_away_from_the_poles():
    points = torch.tensor([[1, 0, 0], [0.3, -2, 0.4], [-1, 0.5, -0.2]], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda p: CAMERA.project(p)[0], points)


def test_resized_sees_the_same_ray_at_the_scaled_pixel():
    small = CAMERA.resized(120, 45)
    pixels = torch.tensor([[0.0, 0.0], [100.0, 33.0]], dtype=torch.float64)
    scaled = (pixels + 0.5) / torch.tensor([3.0, 2.0], dtype=torch.float64) - 0.5
    torch.testing.assert_close(small.unproject(scaled)[0], CAMERA.unproject(pixels)[0])


def test_wrong_elevations_are_named():
    with pytest.raises(ValueError, match=r"top_deg.* 10\.0.*bottom_deg.* 20\.0"):
        Equirectangular(4, 4, 10.0, 20.0)
