"""The panoramic camera: literal pixels, and what every lens model promises."""

import math

import pytest
import torch

from omniocc.camera import Camera, Panoramic

CAMERA = Panoramic(360, 180, 90.0, -90.0)


@pytest.mark.parametrize(
    ("point", "pixel"),
    [
        ((0.0, 0.0, 2.0), (179.5, 89.5)),  # forward
        ((3.0, 0.0, 0.0), (269.5, 89.5)),  # right
        ((-3.0, 0.0, 0.0), (89.5, 89.5)),
        ((0.0, 1.0, 1.0), (179.5, 134.5)),  # down
        ((1.0, -math.sqrt(2), 1.0), (224.5, 44.5)),
    ],
)
def test_known_pixels(point, pixel):
    assert isinstance(CAMERA, Camera)
    found, valid = CAMERA.project(torch.tensor(point, dtype=torch.float64))
    assert valid
    assert found.tolist() == pytest.approx(pixel, abs=1e-9)


def test_pixel_to_ray_to_pixel_and_what_is_outside():
    camera = Panoramic(64, 16, 50.0, -10.0)
    u, v = torch.meshgrid(torch.arange(64.0), torch.arange(16.0), indexing="xy")
    pixels = torch.stack([u, v], -1).double()
    rays, valid = camera.unproject(pixels)
    assert valid.all()
    torch.testing.assert_close(rays.norm(dim=-1), torch.ones(16, 64, dtype=torch.float64))
    found, valid = camera.project(7 * rays)
    assert valid.all()
    torch.testing.assert_close(found, pixels)
    steep = torch.tensor([[0.0, -math.tan(math.radians(a)), 1.0] for a in (49, 51, -9, -11)])
    assert camera.project(steep)[1].tolist() == [True, False, True, False]
    assert camera.resized(32, 8) == Panoramic(32, 8, 50.0, -10.0)
    with pytest.raises(ValueError, match="need -90 <= bottom_deg < top_deg"):
        Panoramic(4, 4, -10.0, 50.0)
