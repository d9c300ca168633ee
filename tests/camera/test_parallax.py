import math

import pytest
import torch

from omniocc.camera import Equidistant, Equirectangular, Rig
from omniocc.camera.parallax import pixels_per_metre, shared_view


def rig_of(*places_m):
    camera = Equidistant(200, 200, 80.0, (99.5, 99.5), 100.0)
    poses = torch.eye(4, dtype=torch.float64).repeat(len(places_m), 1, 1)
    # the optical axis looks ahead: right is -y, down is -z
    poses[:, :3, :3] = torch.tensor([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]], dtype=torch.float64)
    poses[:, :3, 3] = torch.tensor(places_m, dtype=torch.float64)
    return Rig((camera,) * len(places_m), poses, tuple("abc"[: len(places_m)]))


@pytest.mark.parametrize("range_m", [2.0, 10.0, 20.0])
def test_ahead_it_is_the_derivative_of_the_angle_between_the_cameras(range_m):
    rig, base_m = rig_of((0.0, 0.45, 0.0), (0.0, -0.45, 0.0)), 0.9
    found = pixels_per_metre(rig, torch.tensor([range_m, 0.0, 0.0]))
    angle = math.atan2(base_m / 2, range_m)
    focal_px = 80 * math.sqrt(angle / math.sin(angle))  # between that along the radius and that across it
    assert found.item() == pytest.approx(focal_px * base_m / (range_m**2 + base_m**2 / 4), rel=1e-6)


def test_it_is_what_the_images_show():
    rig = rig_of((0.3, 0.45, 0.0), (-0.2, -0.45, 0.1))
    near = torch.tensor([6.0, 1.0, 0.5], dtype=torch.float64)
    far = near * (1 + 1e-6)
    # both cameras look the same way, so that angles in one are angles in the other
    angles = [rig.project(point)[0] / 80 for point in (near, far)]
    parting_px = ((angles[1] - angles[0])[0] - (angles[1] - angles[0])[1]).norm() * 80
    assert pixels_per_metre(rig, near).item() == pytest.approx((parting_px / (1e-6 * near.norm())).item(), rel=0.05)


def test_one_camera_or_the_base_line_itself_tells_nothing():
    one = pixels_per_metre(rig_of((0.0, 0.4, 0.0)), torch.tensor([[5.0, 1.0, 0.0]]))
    assert one.tolist() == [0.0]
    pair = rig_of((0.0, 0.4, 0.0), (0.0, -0.4, 0.0))
    behind, beside = pixels_per_metre(pair, torch.tensor([[-5.0, 0.0, 0.0], [0.0, 5.0, 0.0]])).tolist()
    assert behind == 0
    assert beside == pytest.approx(0, abs=1e-6)


def test_the_best_pair_counts():
    points = torch.randn(20, 3) + torch.tensor([12.0, 0.0, 0.0])
    wide = pixels_per_metre(rig_of((0.0, 0.8, 0.0), (0.0, -0.8, 0.0)), points)
    all_three = pixels_per_metre(rig_of((0.0, 0.8, 0.0), (0.0, 0.6, 0.0), (0.0, -0.8, 0.0)), points)
    assert (all_three >= wide).all()
    assert (wide > 0).all()


def test_the_shared_view_is_the_share_that_two_cameras_see():
    ring = 10.0 * Equirectangular(72, 4, 10.0, -10.0).rays()
    assert shared_view(Rig.load("fisheye6"), ring) == 1.0
    assert shared_view(Rig.load("pinhole6"), ring) == 0.5
    rig = Rig.load("pinhole6")
    alone = Rig(rig.cameras[:1], rig.ego_from_camera[:1], rig.names[:1])
    assert shared_view(alone, ring) == 0.0
