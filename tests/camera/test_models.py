"""Requirements that every lens model meets."""

import itertools
import math

import pytest
import torch

from omniocc.camera import Camera

NAMES = [
    "svs_front",
    "svs_back",
    "svs_left",
    "svs_right",
    "basalt_test_kb4",
    "basalt_test_ds",
    "basalt_test_eucm_euroc",
    "euroc_kb",
    "euroc_ds",
    "euroc_eucm",
    "kitti360_image_03",
    "woodscape_like",
    "ncore_sample",
    "driveworks_sample",
    "ftheta_wide",
    "omnimvs_sunny_single_cam1",
    "omnimvs_sunny_single_cam2",
    "omnimvs_sunny_single_cam3",
    "omnimvs_sunny_single_cam4",
]
KINDS = [
    "svs_back",
    "basalt_test_ds",
    "euroc_eucm",
    "kitti360_image_03",
    "woodscape_like",
    "ncore_sample",
    "ftheta_wide",
    "omnimvs_sunny_single_cam1",
]


@pytest.fixture(params=[*KINDS, "omnimvs_sunny_single_cam1 exact"])
def camera(request, known, build_camera):
    name, _, exact = request.param.partition(" ")
    return build_camera(known["cameras"][name], exact=bool(exact))


def image_pixels(camera, step, dtype=torch.float64):
    u, v = torch.arange(0, camera.width, step, dtype=dtype), torch.arange(0, camera.height, step, dtype=dtype)
    return torch.stack(torch.meshgrid(u, v, indexing="xy"), -1)


def directions(angle_deg, count=12):
    theta, phi = math.radians(angle_deg), torch.linspace(-3, 3.1, count, dtype=torch.float64)
    flat = torch.full_like(phi, math.sin(theta))
    return torch.stack([flat * phi.cos(), flat * phi.sin(), torch.full_like(phi, math.cos(theta))], -1)


@pytest.mark.parametrize("name", NAMES)
def test_known_pixels(name, known, build_camera):
    entry = known["cameras"][name]
    points = torch.tensor(known["points"], dtype=torch.float64)
    vectors = [("vec", False)] if "vec" in entry else [("vec_uv_from_inv_poly", False), ("vec_uv_from_poly_root", True)]
    for key, exact in vectors:
        camera = build_camera(entry, exact)
        assert isinstance(camera, Camera)
        pixels, valid = camera.project(2.5 * points)
        for pixel, visible, expected in zip(pixels, valid, entry[key], strict=True):
            if expected is None and not (exact and pixel.tolist() == [399, 383]):
                assert not visible
            elif expected is not None:
                assert pixel.tolist() == pytest.approx(expected, abs=1e-4)
                inside = 0 <= expected[0] < camera.width and 0 <= expected[1] < camera.height
                assert inside or not visible


@pytest.mark.parametrize(("dtype", "atol"), [(torch.float32, 1e-3), (torch.float64, 1e-8)])
def test_pixel_to_ray_to_pixel(camera, dtype, atol):
    pixels = image_pixels(camera, 7, dtype)
    rays, valid = camera.unproject(pixels)
    assert rays.dtype == dtype
    assert valid.float().mean() > 0.6
    torch.testing.assert_close(rays.norm(dim=-1), torch.ones_like(pixels[..., 0]))
    back, visible = camera.project(13 * rays)
    inverse_is_fitted = bool(getattr(camera, "inverse_polynomial", ()))
    assert (back - pixels)[valid].abs().max() < (1e-2 if inverse_is_fitted else atol)
    assert visible[valid].float().mean() > 0.995, "only rays at the very limit may fall to either side"


def test_points_beyond_the_limit_are_invalid_and_no_pixel_has_two_angles(camera):
    angles = torch.linspace(0.5, 179.5, 360).tolist()
    radii = []
    for angle_deg in angles:
        pixels, valid = camera.project(directions(angle_deg))
        assert pixels.isfinite().all()
        if valid.any():
            radii.append((pixels - pixels.new_tensor(camera.center_px))[valid].norm(dim=-1).min())
    assert all(b > a for a, b in itertools.pairwise(radii)) or len(radii) < 2
    assert not camera.project(directions(179))[1].any()


def test_max_angle_ends_the_model(known, build_camera):
    for name in KINDS:
        narrow = build_camera(known["cameras"][name], max_angle_deg=20.0)
        inside, outside = directions(19.99), directions(20.01)
        assert narrow.project(inside)[1].all()
        assert not narrow.project(outside)[1].any()
        wide = build_camera(known["cameras"][name])
        assert not narrow.unproject(wide.project(outside)[0])[1].any()


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_no_nan_where_the_formula_is_undefined(camera, dtype):
    rows = [
        [0, 0, 1],
        [0, 0, -1],
        [0, 0, 0],
        [1e-30, 0, 1],
        [1e-9, -1e-9, 2],
        [0, 0, 1e-12],
        [1e6, 2e6, -3e6],
        [0, 1, 0],
    ]
    points = torch.tensor(rows, dtype=dtype, requires_grad=True)
    pixels, valid = camera.project(points)
    pixels.sum().backward()
    assert pixels.isfinite().all()
    assert points.grad.isfinite().all()
    assert valid[[0, 3, 4, 5]].all()
    assert not valid[[1, 2]].any()
    cx, cy = camera.center_px
    far = [[cx, cy], [cx + 1e-20, cy], [-1e5, 3e5], [cx, cy - 5000.0], [cx + 1e-3, cy]]
    pixels = torch.tensor(far, dtype=dtype, requires_grad=True)
    rays, valid = camera.unproject(pixels)
    rays.sum().backward()
    assert rays.isfinite().all()
    assert pixels.grad.isfinite().all()
    assert valid[[0, 1, 4]].all()
    assert not valid[2]


def test_gradients(camera):
    points = torch.cat([2 * directions(angle_deg, 3) for angle_deg in (1e-3, 25, 55, 70)]).requires_grad_()
    assert torch.autograd.gradcheck(lambda p: camera.project(p)[0], points, atol=1e-3, eps=1e-7)
    pixels = torch.tensor(camera.center_px).double() + torch.tensor([[0.3, 0.2], [60, -40], [-110, 80.0]])
    assert torch.autograd.gradcheck(lambda p: camera.unproject(p)[0], pixels.double().requires_grad_(), atol=1e-7)


def test_gradient_on_the_axis_is_the_slope_beside_it(camera):
    fitted = bool(getattr(camera, "inverse_polynomial", ()))  # its radius is a few hundredths of a pixel on the axis
    step, tolerance = (0.2, 0.05) if fitted else (1e-6, 1e-6)
    ahead = torch.tensor([0.0, 0, 2], dtype=torch.float64, requires_grad=True)
    pixel, _ = camera.project(ahead)
    (slope,) = torch.autograd.grad(pixel[0], ahead)
    aside, _ = camera.project(torch.tensor([[step, 0, 2], [-step, 0, 2]], dtype=torch.float64))
    assert float(slope[0]) == pytest.approx(float(aside[0, 0] - aside[1, 0]) / (2 * step), rel=tolerance)


def test_any_batch_shape(camera):
    assert camera.project(torch.rand(2, 5, 3))[0].shape == (2, 5, 2)
    assert camera.project(torch.rand(3))[1].shape == ()
    assert camera.unproject(torch.rand(0, 2))[0].shape == (0, 3)
    assert camera.unproject(torch.rand(2))[1].shape == ()


def test_resized_sees_the_same_ray_at_the_scaled_pixel(camera):
    small = camera.resized(camera.width // 2, camera.height // 4)
    scale = torch.tensor([small.width / camera.width, small.height / camera.height], dtype=torch.float64)
    pixels = image_pixels(camera, 11)
    rays, valid = camera.unproject(pixels)
    small_rays, small_valid = small.unproject((pixels + 0.5) * scale - 0.5)
    both = valid & small_valid
    assert both.sum() > 0.99 * valid.sum()
    torch.testing.assert_close(small_rays[both], rays[both], rtol=0, atol=1e-6)
    points = 5 * directions(40)
    torch.testing.assert_close((camera.project(points)[0] + 0.5) * scale - 0.5, small.project(points)[0])
