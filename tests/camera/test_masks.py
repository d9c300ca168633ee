import math

import pytest
import torch

from omniocc.camera import Rig
from omniocc.camera.masks import mask_cameras, mask_view, usable_pixels

RIG = Rig.load("fisheye6").resized(64, 36)


def test_a_camera_that_is_left_out_sees_nothing_and_the_others_as_before():
    masked = mask_cameras(RIG, ("rear",))
    for name, before, after in zip(RIG.names, usable_pixels(RIG), usable_pixels(masked), strict=True):
        assert torch.equal(after, torch.zeros_like(before) if name == "rear" else before)


@pytest.mark.parametrize("view_deg", [90.0, 180.0, 270.0])
def test_pixels_outside_the_horizontal_sector_are_masked(view_deg):
    """Compared with a loop over pixels in plain float64."""
    rig = mask_view(RIG, view_deg)
    masks, before = usable_pixels(rig), usable_pixels(RIG)
    kept = 0
    for camera, model in enumerate(RIG.cameras):
        rotation = RIG.ego_from_camera[camera, :3, :3].tolist()
        for v in range(0, 36, 5):
            for u in range(0, 64, 5):
                ray = model.unproject(torch.tensor([[u, v]], dtype=torch.float64))[0][0].tolist()
                x, y = (sum(rotation[row][k] * ray[k] for k in range(3)) for row in (0, 1))
                azimuth_deg = math.degrees(math.atan2(y, x))
                if abs(abs(azimuth_deg) - view_deg / 2) > 1e-3:
                    assert bool(masks[camera][v, u]) == (bool(before[camera][v, u]) and abs(azimuth_deg) < view_deg / 2)
                kept += bool(masks[camera][v, u])
    assert kept > 0
    ahead, behind = torch.tensor([8.0, 0.5, -1.0]), torch.tensor([-8.0, 0.5, -1.0])
    assert rig.project(ahead)[1].any()
    assert not rig.project(behind)[1].any()


def test_the_whole_view_is_the_rig():
    assert all(map(torch.equal, usable_pixels(mask_view(RIG, 360.0)), usable_pixels(RIG)))
