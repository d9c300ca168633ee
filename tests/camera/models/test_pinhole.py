import cv2
import numpy as np
import pytest
import torch

from omniocc.camera import Pinhole

CAMERA = Pinhole(640, 480, (300.0, 320.0), (319.5, 239.0))


def test_agrees_with_opencv():
    rng = np.random.default_rng(0)
    points = rng.uniform((-2, -2, 1), (2, 2, 5), (100, 3))
    matrix = np.array([[300.0, 0, 319.5], [0, 320.0, 239.0], [0, 0, 1]])
    expected, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), matrix, None)
    expected = expected[:, 0]
    pixels, valid = CAMERA.project(torch.from_numpy(points))
    np.testing.assert_allclose(pixels.numpy(), expected, rtol=0, atol=1e-9)
    inside = (expected >= -0.5).all(1) & (expected <= [639.5, 479.5]).all(1)
    np.testing.assert_array_equal(valid.numpy(), inside)


@pytest.mark.parametrize(("dtype", "atol"), [(torch.float32, 2e-4), (torch.float64, 1e-10)])
def test_round_trips(dtype, atol):
    pixels = torch.rand(300, 2, dtype=dtype) * torch.tensor([639, 479], dtype=dtype)
    pixels[0] = torch.tensor([319.5, 239.0])
    rays, valid = CAMERA.unproject(pixels)
    assert valid.all()
    torch.testing.assert_close(rays.norm(dim=-1), torch.ones(300, dtype=dtype))
    assert rays[0].tolist() == [0, 0, 1]
    back, visible = CAMERA.project(9 * rays)
    torch.testing.assert_close(back, pixels, rtol=0, atol=atol)
    assert visible.all()


def test_behind_and_in_the_camera_plane_is_finite_and_invalid():
    points = torch.tensor([[0, 0, -1], [1, 0, 0], [0, 0, 0], [1, 1, 1e-30], [0.1, 0.1, -3.0]], requires_grad=True)
    pixels, valid = CAMERA.project(points)
    pixels.sum().backward()
    assert not valid.any()
    assert pixels.isfinite().all()
    assert points.grad.isfinite().all()


def test_gradients():
    points = torch.tensor([[0, 0, 1.0], [0.3, -0.2, 2.0]], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda p: CAMERA.project(p)[0], points)
    pixels = torch.tensor([[319.5, 239.0], [5.0, 400.0]], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda p: CAMERA.unproject(p)[0], pixels)


def test_resized_sees_the_same_ray_at_the_scaled_pixel():
    wide = CAMERA.resized(1280, 240)
    pixels = torch.rand(50, 2, dtype=torch.float64) * 400
    scaled = (pixels + 0.5) * torch.tensor([2.0, 0.5], dtype=torch.float64) - 0.5
    torch.testing.assert_close(wide.unproject(scaled)[0], CAMERA.unproject(pixels)[0], rtol=0, atol=1e-12)
    assert (wide.width, wide.height) == (1280, 240)


def test_wrong_focal_length_is_named():
    with pytest.raises(ValueError, match=r"focal_px is -1\.0"):
        Pinhole(4, 4, (1.0, -1.0), (1.5, 1.5))
