import math
from dataclasses import replace

import pytest
import torch

from omniocc.camera import Equirectangular, Rig
from omniocc.model.depth import Spheres
from omniocc.model.ops.depth.spheres import SphereRange, nearest_range_m, road_range_m

PANORAMA = Equirectangular(192, 48, 45.0, -45.0)


def test_index_and_range_are_inverse():
    spheres = Spheres(32, 1.6)
    index = torch.linspace(0.1, 31, 400, dtype=torch.float64)
    torch.testing.assert_close(spheres.index(spheres.range_m(index)), index)
    assert spheres.index(torch.tensor([float("inf"), 1.6])).tolist() == pytest.approx([0, 31])


def test_spheres_of_the_original_setting():
    # OmniMVS on Urban: 192 spheres from 1.65 m; steps of 0.71 m at 15 m and 2.08 m at 25.6 m
    spheres = Spheres(192, 1.65)
    for range_m, step_m in ((5.0, 0.079), (15.0, 0.714), (25.6, 2.080)):
        assert range_m**2 * spheres.step_per_m == pytest.approx(step_m, abs=5e-4)
    radii = spheres.range_m(torch.arange(1, spheres.count).double())
    assert radii[0].item() == pytest.approx(315.15)
    assert radii[-1].item() == pytest.approx(1.65)


def test_ranges_stay_finite():
    spheres = Spheres(32, 1.6)
    assert spheres.range_m(torch.zeros(3)).tolist() == pytest.approx([496.0] * 3)
    assert spheres.farthest_m == pytest.approx(496.0)


@pytest.mark.parametrize(("count", "range_m"), [(1, 1.0), (True, 1.0), (8, 0.0), (8, -1.0), (8, float("inf"))])
def test_impossible_spheres_are_refused(count, range_m):
    with pytest.raises(ValueError, match=r"spheres is|min_range_m is"):
        Spheres(count, range_m)
    with pytest.raises(ValueError, match=r"spheres is|min_range_m is"):
        SphereRange(count, range_m)


def test_nearest_sphere_is_where_two_cameras_begin_to_see_nearly_everything():
    masked = Rig.load("fisheye6").resized(256, 144)
    rig = replace(masked, masks=None)
    nearest_m = nearest_range_m(rig, PANORAMA)
    assert nearest_range_m(masked, PANORAMA) == nearest_m
    assert 1.4 < nearest_m < 1.7

    def shared(range_m):
        cameras = rig.project(PANORAMA.resized(128, 32).rays().double() * range_m)[1].sum(0)
        return float((cameras >= 2).sum() / (cameras >= 1).sum())

    assert shared(nearest_m) >= 0.9
    assert shared(nearest_m - 0.1) < 0.9


@pytest.mark.parametrize("name", ["pinhole6", "surround_view"])
def test_where_fields_hardly_overlap_it_is_twice_the_innermost_camera(name):
    rig = replace(Rig.load(name), road_z_m=None)
    innermost_m = float(rig.ego_from_camera[:, :3, 3].norm(dim=-1).min())
    assert nearest_range_m(rig, PANORAMA) == pytest.approx(2 * innermost_m, abs=1e-3)


def test_it_is_not_beyond_the_road_at_the_lower_edge():
    low = replace(Rig.load("fisheye6"), road_z_m=-0.9)
    # at 45 degrees below the horizon
    assert nearest_range_m(low, Equirectangular(64, 16, 45.0, -45.0)) == pytest.approx(0.9 * math.sqrt(2), abs=1e-3)
    high = replace(low, road_z_m=-2.2)
    assert nearest_range_m(high, PANORAMA) == nearest_range_m(replace(low, road_z_m=None), PANORAMA)
    assert nearest_range_m(replace(low, road_z_m=-0.2), PANORAMA) == 0.5
    assert road_range_m(-1.0, 10.0) == road_range_m(None, -45.0) == road_range_m(0.5, -45.0) == math.inf


def test_a_given_range_goes_before_the_rig(rig):
    assert SphereRange(16, 2.5).of(rig, PANORAMA) == Spheres(16, 2.5)
    assert SphereRange(16, None).of(rig, PANORAMA).min_range_m == nearest_range_m(rig, PANORAMA)
