import math

import pytest
import torch

from omniocc.camera import Equirectangular
from omniocc.model.depth.zbuffer import camera_rays, draw_nearest, fill_holes, merge_cameras

PANORAMA = Equirectangular(16, 5, 45.0, -45.0)
INF = float("inf")


def looped(points_m, value, drawn):
    nearest, values = [[INF] * 16 for _ in range(5)], [[0.0] * 16 for _ in range(5)]
    for (x, y, z), each, counts in zip(points_m.tolist(), value.tolist(), drawn.tolist(), strict=True):
        column = int((math.pi - math.atan2(y, x)) / (2 * math.pi) * 16) % 16
        row = math.floor((45 - math.degrees(math.atan2(z, math.hypot(x, y)))) / 90 * 5)
        range_m = math.sqrt(x * x + y * y + z * z)
        if counts and 0 <= row < 5 and range_m < nearest[row][column]:
            nearest[row][column], values[row][column] = range_m, each
    return torch.tensor(nearest, dtype=torch.float64), torch.tensor(values, dtype=torch.float64)


def test_nearest_point_of_each_pixel():
    torch.manual_seed(0)
    points_m = 4 * torch.randn(2, 300, 3, dtype=torch.float64)
    value, drawn = torch.rand(2, 300, dtype=torch.float64), torch.rand(2, 300) < 0.8
    nearest, values = draw_nearest(points_m, value, drawn, PANORAMA)
    for sample in range(2):
        expected, expected_values = looped(points_m[sample], value[sample], drawn[sample])
        torch.testing.assert_close(nearest[sample], expected)
        torch.testing.assert_close(values[sample], expected_values)
    assert nearest.isinf().any()


def test_straight_behind():
    nearest, _ = draw_nearest(torch.tensor([[[-2.0, 0.0, 0.0]]]), torch.ones(1, 1), torch.tensor([[True]]), PANORAMA)
    assert nearest[0, 2, 0] == 2 or nearest[0, 2, 15] == 2


def test_a_ball_around_the_origin_is_seen_as_one(rig):
    # range from each camera's centre to a ball of 6 m around the ego origin
    rays, _ = camera_rays(rig, (64, 36), torch.device("cpu"))
    centers_m = rig.ego_from_camera[:, None, None, :3, 3].float()
    along = (rays * centers_m).sum(-1)
    range_m = -along + (along.square() + 36 - centers_m.square().sum(-1)).sqrt()
    assert range_m.amin() == pytest.approx(5.1, abs=0.01)
    assert range_m.amax() > 6.2
    merged, value = merge_cameras(range_m[None], torch.ones(1, 6, 36, 64), torch.ones(1, 6, 36, 64) > 0, rig, PANORAMA)
    seen = merged.isfinite()
    assert seen.float().mean() > 0.95
    torch.testing.assert_close(merged[seen], torch.full_like(merged[seen], 6.0))
    assert torch.equal(value > 0, seen)


def test_holes_take_what_lies_behind():
    rows = torch.full((1, 3, 4), INF)
    rows[0, 1] = torch.tensor([2.0, INF, 9.0, INF])
    filled = fill_holes(rows, 1)
    assert filled[0, 1].tolist() == [2, 9, 9, 9]
    assert filled[0, 0].tolist() == [2, INF, 9, INF]
    assert torch.equal(fill_holes(rows, 0), rows)
