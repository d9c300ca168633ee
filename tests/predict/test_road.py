"""The flat road in predicted ranges, and the height of the grid above it."""

import math
from dataclasses import replace
from types import SimpleNamespace

import pytest
import torch

from omniocc.camera import Equirectangular, Rig
from omniocc.errors import UserError
from omniocc.model.depth import Spheres
from omniocc.model.ops.depth.depth_map import from_index
from omniocc.predict.road import check_within, flat_road_m, on_road, pulled_to_road, road_line

PANORAMA, SPHERES = Equirectangular(8, 12, 45.0, -45.0), Spheres(32, 1.0)
RIG = Rig.load("surround_view")


def depth_at(index):
    everywhere = torch.ones(1, 12, 8)
    return from_index(index.expand(1, 12, 8), everywhere > 0, everywhere / 2, SPHERES)


def test_a_flat_road_lies_at_its_height():
    z_m = flat_road_m(PANORAMA, -1.2) * PANORAMA.rays()[..., 2]
    assert torch.allclose(z_m[6:], torch.tensor(-1.2))
    assert bool(flat_road_m(PANORAMA, -1.2)[:6].isinf().all())


def test_only_ranges_close_to_the_road_are_drawn_onto_it():
    flat_m = flat_road_m(PANORAMA, -1.2)
    road = SPHERES.index(flat_m)
    for away, left in ((0.1, 0.1 * (1 - math.exp(-0.16))), (-0.1, -0.1 * (1 - math.exp(-0.16))), (2.0, 2.0)):
        before = depth_at(road + away)
        after = pulled_to_road(before, SPHERES, flat_m, 0.25)
        assert torch.allclose(after.index[:, 6:], (road + left)[6:].expand(1, 6, 8), atol=1e-5)
        assert torch.allclose(after.range_m[:, 6:], SPHERES.range_m(after.index[:, 6:]))
        assert torch.equal(after.index[:, :6], before.index[:, :6])
        assert torch.equal(after.range_m[:, :6], before.range_m[:, :6])
        assert (after.valid is before.valid, after.confidence is before.confidence) == (True, True)


def test_ranges_stay_unless_the_network_is_told_the_height():
    depth = depth_at(torch.tensor(3.0))
    told = SimpleNamespace(hints=True, panorama=PANORAMA, rig_spheres=lambda rig: SPHERES)
    assert on_road(depth, told, RIG, 0.0) is depth
    assert on_road(depth, told, replace(RIG, road_z_m=None), 0.25) is depth
    assert on_road(depth, SimpleNamespace(hints=False), RIG, 0.25) is depth
    assert on_road(depth, SimpleNamespace(), RIG, 0.25) is depth
    expected = pulled_to_road(depth, SPHERES, flat_road_m(PANORAMA, -0.916), 0.25)
    assert torch.equal(on_road(depth, told, RIG, 0.25).range_m, expected.range_m)


def test_the_measured_height_of_the_road_by_distance():
    panorama = Equirectangular(8, 90, 45.0, -45.0)
    range_m = 0.9 * flat_road_m(panorama, -1.2)
    range_m[:48] = torch.nan
    assert road_line(range_m, panorama, -1.2) == ("road at -1.08 m at 0-8.5 m, -1.08 m at 8.5-17 m (road_z_m: -1.2 m)")
    assert road_line(0.5 * range_m, panorama, -1.2) == ""


@pytest.mark.parametrize("value", [-0.1, math.inf, math.nan, True, "near"])
def test_other_values_of_the_option_are_named(value):
    with pytest.raises(UserError, match=f"road_within={value}.*0 or more"):
        check_within(value)
    assert check_within(1) == 1.0
