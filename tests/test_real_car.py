"""What is known of four real images, and the scores of ranges against it."""

import pytest
import real_car
import torch

from omniocc.camera import Equirectangular, Rig

RIG, PANORAMA = Rig.load("surround_view"), Equirectangular(192, 48, 45.0, -45.0)


def test_things_stand_on_the_road_at_plausible_places():
    points_m = real_car.foot_points(RIG)
    assert points_m.shape == (12, 3)
    assert points_m[:, 2].tolist() == pytest.approx([-0.916] * 12)
    distances_m = dict(zip(real_car.THINGS, points_m.norm(dim=-1).tolist(), strict=True))
    assert 6.5 < distances_m["hedge in front"] < 7.5
    assert 14 < distances_m["van"] < 18
    assert all(4 < distance_m < 18 for distance_m in distances_m.values())
    for name, (x, y, _) in zip(real_car.THINGS, points_m.tolist(), strict=True):
        outside = not (-5.6 < x < 4.5 and -3.1 < y < 3.1)
        assert outside, f"{name} stands on the cloth"


def test_a_flat_road_is_right_on_the_cloth_and_behind_everything_that_stands():
    flat_m = real_car.road_m(PANORAMA.rays().double(), -0.916)
    found = real_car.score(flat_m, PANORAMA, RIG)
    assert found == (1.0, 1.0, 0.0, 0)


def test_the_right_distance_counts_and_errors_do_not():
    points_m = real_car.foot_points(RIG) + torch.tensor([0.0, 0.0, real_car.BODY_M])
    pixels = PANORAMA.project(points_m)[0].round().long()
    range_m = 1.2 * real_car.road_m(PANORAMA.rays().double(), -0.916)
    range_m[pixels[:, 1], pixels[:, 0] % 192] = 1.1 * points_m.norm(dim=-1)
    found = real_car.score(range_m, PANORAMA, RIG)
    assert found.near == 0
    assert found.median == pytest.approx(0.2)
    assert found.things >= 11  # two of them may share a pixel
    assert real_car.score(range_m * torch.nan, PANORAMA, RIG).answered == 0


def test_the_hole_in_the_cloth_is_left_out():
    points_m = torch.tensor([[[0.0, 0.0, -0.9], [3.0, 0.0, -0.9], [0.0, 2.0, -0.9], [6.0, 0.0, -0.9]]])
    assert real_car.on_cloth(points_m).tolist() == [[False, True, True, False]]
