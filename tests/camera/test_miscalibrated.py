import dataclasses
import math

import numpy as np
import pytest
import torch

from omniocc.camera import Equirectangular, Rig
from omniocc.camera.miscalibrated import displaced_rig, rotations, turned, with_focal_factor, with_focal_factors
from omniworld.drawn import _DRAW, draw_lens

RIG = Rig.load("fisheye6").resized(64, 36)
AXES = torch.from_numpy(np.random.default_rng(0).standard_normal((6, 3)))


@pytest.mark.parametrize("angle_deg", [0.1, 1.0, 3.0, 170.0])
def test_cameras_are_turned_by_exactly_this_angle_around_this_axis_of_theirs(angle_deg):
    wrong = turned(RIG, AXES, angle_deg)
    assert torch.equal(wrong.ego_from_camera[:, :3, 3], RIG.ego_from_camera[:, :3, 3])
    for true, other, axis in zip(RIG.ego_from_camera, wrong.ego_from_camera, AXES, strict=True):
        error = true[:3, :3].T @ other[:3, :3]
        assert math.degrees(math.acos((float(error.trace()) - 1) / 2)) == pytest.approx(angle_deg, abs=1e-6)
        torch.testing.assert_close(error @ axis, axis)  # the axis stays


def test_a_rotation_is_that_of_rodrigues():
    """v cos + (k x v) sin + k (k . v) (1 - cos), in plain numpy."""
    axis, vector, angle = np.array([0.6, 0.0, 0.8]), np.array([0.3, -1.0, 2.0]), math.radians(25)
    cos, sin = math.cos(angle), math.sin(angle)
    expected = vector * cos + np.cross(axis, vector) * sin + axis * (axis @ vector) * (1 - cos)
    found = rotations(torch.tensor(7 * axis)[None], 25.0)[0].numpy() @ vector
    np.testing.assert_allclose(found, expected, atol=1e-12)


def test_cameras_are_moved_by_exactly_this_distance():
    wrong = displaced_rig(RIG, AXES, 0.03)
    shift = wrong.ego_from_camera[:, :3, 3] - RIG.ego_from_camera[:, :3, 3]
    torch.testing.assert_close(shift.norm(dim=1), torch.full((6,), 0.03, dtype=torch.float64))
    torch.testing.assert_close(shift, 0.03 * AXES / AXES.norm(dim=1, keepdim=True))
    assert torch.equal(wrong.ego_from_camera[:, :3, :3], RIG.ego_from_camera[:, :3, :3])


@pytest.mark.parametrize("lens", list(_DRAW))
@pytest.mark.parametrize("factor", [0.9, 0.99, 1.03])
def test_pixels_are_this_much_farther_from_the_centre_for_every_lens(lens, factor):
    camera = draw_lens(np.random.default_rng(5), lens, 256, 144, 150.0, 0.9)
    wrong = with_focal_factor(camera, factor)
    assert (type(wrong), wrong.width, wrong.height, wrong.center_px) == (type(camera), 256, 144, camera.center_px)
    rays = camera.unproject(torch.tensor([[128.0, 72.0], [150.0, 60.0], [100.0, 90.0]], dtype=torch.float64))[0]
    center = torch.tensor(camera.center_px, dtype=torch.float64)
    before, after = camera.project(rays)[0] - center, wrong.project(rays)[0] - center
    torch.testing.assert_close(after, factor * before, rtol=1e-5, atol=1e-5)


def test_every_camera_has_its_own_factor():
    wrong = with_focal_factors(RIG, [1.0, 1.1, 0.9, 1.0, 1.0, 1.0])
    ratios = [other.focal_px / true.focal_px for true, other in zip(RIG.cameras, wrong.cameras, strict=True)]
    assert ratios == pytest.approx([1.0, 1.1, 0.9, 1.0, 1.0, 1.0])
    assert wrong.masks is RIG.masks
    assert dataclasses.replace(wrong, cameras=RIG.cameras) == RIG


def test_a_panorama_has_no_focal_length():
    with pytest.raises(ValueError, match="Equirectangular has no centre"):
        with_focal_factor(Equirectangular(64, 32, 45.0, -45.0), 1.1)
