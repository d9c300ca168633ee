import pytest
import torch

from omniocc.camera import MEI, Equidistant, Pinhole
from omniocc.camera.models.mirrored import Mirrored, mirrored

CAMERAS = [
    Equidistant(64, 36, 19.3, (30.0, 18.5), 95.0),
    Pinhole(64, 36, (40.0, 42.0), (33.0, 17.0)),
    MEI(64, 36, (60.0, 61.0), (33.0, 17.0), 1.2, (-0.03, 0.01, 0.004, -0.006), 100.0),
]
OTHERS = [
    Equidistant(64, 36, 19.3, (33.0, 18.5), 95.0),
    Pinhole(64, 36, (40.0, 42.0), (30.0, 17.0)),
    MEI(64, 36, (60.0, 61.0), (30.0, 17.0), 1.2, (-0.03, 0.01, 0.004, 0.006), 100.0),
]
POINTS = torch.randn(2000, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)


@pytest.mark.parametrize("camera", CAMERAS)
def test_the_mirrored_world_falls_on_the_flipped_image(camera):
    pixels, valid = camera.project(POINTS)
    flipped, same = mirrored(camera).project(POINTS * torch.tensor([-1.0, 1.0, 1.0]))
    assert torch.equal(valid, same)
    torch.testing.assert_close(flipped[valid, 0], 63 - pixels[valid, 0])
    torch.testing.assert_close(flipped[valid, 1], pixels[valid, 1])


@pytest.mark.parametrize(("camera", "other"), list(zip(CAMERAS, OTHERS, strict=True)))
def test_principal_point_and_tangential_distortion_change_sides(camera, other):
    (pixels, valid), (expected, expected_valid) = mirrored(camera).project(POINTS), other.project(POINTS)
    assert torch.equal(valid, expected_valid)
    assert valid.sum() > 50
    torch.testing.assert_close(pixels[valid], expected[valid])
    small = mirrored(camera).resized(32, 18).project(POINTS)[0][valid]
    torch.testing.assert_close(small, other.resized(32, 18).project(POINTS)[0][valid])


@pytest.mark.parametrize("camera", CAMERAS)
def test_rays_lead_back_to_their_pixels(camera):
    grid = torch.stack(torch.meshgrid(torch.arange(64.0), torch.arange(36.0), indexing="xy"), dim=-1).double()
    rays, valid = mirrored(camera).unproject(grid)
    assert torch.equal(valid, camera.unproject(grid)[1].flip(1))
    torch.testing.assert_close(mirrored(camera).project(rays)[0][valid], grid[valid])


def test_twice_is_the_camera_itself():
    assert mirrored(mirrored(CAMERAS[0])) is CAMERAS[0]
    assert mirrored(CAMERAS[0]) == Mirrored(CAMERAS[0]) != CAMERAS[0]
    assert repr(mirrored(CAMERAS[0])) != repr(CAMERAS[0])  # fingerprints of rigs contain it
