from dataclasses import replace

import pytest
import torch

from omniocc.camera import Equirectangular
from omniocc.camera.parallax import pixels_per_metre
from omniocc.model.depth import Spheres
from omniocc.model.ops.depth.hints import HINTS, PROBES_M, rig_hints

PANORAMA, SPHERES = Equirectangular(24, 8, 60.0, -60.0), Spheres(16, 1.5)


def test_the_road_is_where_a_flat_road_is(rig):
    maps = rig_hints(replace(rig, road_z_m=-1.4), PANORAMA, SPHERES)
    assert maps.shape == (HINTS, 8, 24)
    rays = PANORAMA.rays()
    for row in range(8):
        if rays[row, 0, 2] >= 0:
            assert not maps[3, row].any()
        else:
            range_m = -1.4 / rays[row, :, 2]
            torch.testing.assert_close(maps[3, row], (SPHERES.index(range_m) / 16).clamp(max=1), atol=1e-5, rtol=1e-5)
    assert (maps[4] == 1).all()
    unknown = rig_hints(replace(rig, road_z_m=None), PANORAMA, SPHERES)
    assert not unknown[3:].any()
    assert torch.equal(unknown[:3], maps[:3])


def test_parallax_is_per_sphere_and_cameras_are_counted(rig):
    maps = rig_hints(rig, PANORAMA, SPHERES)
    rays = PANORAMA.rays().double()
    for found, range_m in zip(maps, PROBES_M, strict=False):
        near = pixels_per_metre(rig, rays * range_m) * range_m**2 * SPHERES.step_per_m
        torch.testing.assert_close(found.double().expm1(), near, atol=1e-4, rtol=1e-4)
    assert maps[2].max() <= 1
    assert maps[2, 4, 0] == pytest.approx(float(rig.project(rays[4, 0] * 1e3)[1].sum()) / 4)
