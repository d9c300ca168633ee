"""The masks of OccTrack360: the field of view by a plain formula of the lens, rays against an exact traversal."""

import math

import numpy as np
import pytest
import torch
from kitti_files import LENSES

from omniocc.camera import MEI, Equidistant, Rig
from omniocc.camera.pose import pose_from_angles
from omniocc.data.labels.visible import field_of_view_mask, ray_traced_mask, surface_cells
from omniocc.geometry import Cuboid

GRID = Cuboid((16, 16, 16), (-4, 4), (-4, 4), (-4, 4))


def rig_of(camera, *poses):
    stacked = torch.stack([pose_from_angles(*pose) for pose in poses])
    return Rig((camera,) * len(poses), stacked, tuple(f"c{k}" for k in range(len(poses))))


def lens():
    xi, k1, k2, p1, p2, g1, g2, u0, v0 = LENSES["image_02"]
    return MEI(1400, 1400, (g1, g2), (u0, v0), xi, (k1, k2, p1, p2), 97.5)


def sees(x, y, z):
    """Return whether the left fisheye of KITTI-360 sees a point of its frame: the formula of Mei, in plain floats."""
    xi, k1, k2, p1, p2, g1, g2, u0, v0 = LENSES["image_02"]
    length = math.sqrt(x * x + y * y + z * z)
    if math.degrees(math.acos(z / length)) > 97.5:
        return False
    x, y = x / (z + xi * length), y / (z + xi * length)
    r2 = x * x + y * y
    s = 1 + k1 * r2 + k2 * r2 * r2
    u = g1 * (s * x + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)) + u0
    v = g2 * (s * y + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y) + v0
    return -0.5 <= u <= 1399.5 and -0.5 <= v <= 1399.5


def test_the_field_of_view_is_that_of_the_full_model():
    seen = field_of_view_mask(GRID, rig_of(lens(), ((0.1, 0.2, 0.3), 90.0, 0.0, 0.0)))
    middles = np.arange(16) * 0.5 - 3.75
    expected = np.zeros((16, 16, 16), bool)
    for place in np.ndindex(16, 16, 16):
        x, y, z = middles[list(place)] - (0.1, 0.2, 0.3)
        expected[place] = sees(x, -z, y)  # it looks to the left: right is forward, down is down
    assert seen.numpy().sum() == expected.sum()
    assert (seen.numpy() == expected).all()
    assert seen[:, :8].any()  # beyond 90 degrees, which division by z loses
    assert not seen[8, 2].any()


def test_the_two_masks_are_not_the_same():
    rig = rig_of(Equidistant(64, 64, 16.0, (31.5, 31.5), 60.0), ((0.1, 0.2, 0.3), 0.0, 0.0, 0.0))
    labels = torch.zeros(GRID.shape, dtype=torch.uint8)
    labels[12] = 1  # a wall ahead, from 2 to 2.5 m
    view, rays = field_of_view_mask(GRID, rig), ray_traced_mask(GRID, labels, rig)
    assert view[14, 8, 8]  # in view, hidden by the wall
    assert not rays[13:].any()
    assert rays[12, 4:12, 4:12].all()  # the first occupied cells are seen
    assert rays[11, 0, 0]  # beside the lens, but no wall hides it
    assert not view[9, 0, 0]
    assert not rays[:8].any()  # behind the camera


def test_cameras_to_both_sides_see_together_what_nothing_hides():
    rig = rig_of(lens(), ((0.1, 0.2, 0.3), 90.0, 0.0, 0.0), ((0.1, -0.2, 0.3), -90.0, 0.0, 0.0))
    labels = torch.zeros(GRID.shape, dtype=torch.uint8)
    labels[:, 12] = labels[:, 3] = 7
    seen = ray_traced_mask(GRID, labels, rig)
    assert seen[4:12, 3, 4:12].all()
    assert seen[4:12, 12, 4:12].all()
    assert not seen[:, 13:].any()
    assert not seen[:, :3].any()


def test_rays_cross_the_cells_that_an_exact_traversal_finds():
    grid = Cuboid((7, 9, 5), (-2.1, 1.4), (-1.0, 2.6), (-1.5, 1.0))
    labels = (torch.rand(grid.shape, generator=torch.Generator().manual_seed(3)) < 0.15).to(torch.uint8)
    rig = rig_of(lens(), ((0.1713, 0.4127, -0.2659), 37.0, 12.0, 0.0))
    pose = rig.ego_from_camera[0]
    places = torch.from_numpy(surface_cells(grid.shape))
    middles = grid.centers(torch.float64)[places.unbind(1)]
    ways = middles - pose[:3, 3]
    ways, ends = ways[ways @ pose[:3, 2] > 0], places[ways @ pose[:3, 2] > 0]
    expected = torch.zeros(grid.num_cells, dtype=torch.bool)
    strides = torch.tensor([45, 5, 1])
    for cells, end in zip(grid.paths(pose[:3, 3].expand_as(ways), ways).cells.tolist(), ends @ strides, strict=True):
        for cell in cells[: cells.index(int(end)) + 1]:
            expected[cell] = True
            if labels.flatten()[cell]:
                break
    assert 100 < int(expected.sum()) < grid.num_cells - 20
    assert torch.equal(ray_traced_mask(grid, labels, rig).flatten(), expected)


def test_what_is_impossible_is_named():
    rig = rig_of(lens(), ((9.0, 0.0, 0.0), 0.0, 0.0, 0.0))
    with pytest.raises(ValueError, match="camera 'c0' is outside of the volume"):
        ray_traced_mask(GRID, torch.zeros(GRID.shape, dtype=torch.uint8), rig)
    with pytest.raises(ValueError, match=r"the shape of their grid, \(16, 16, 16\), got \(1, 1, 1\)"):
        ray_traced_mask(GRID, torch.zeros(1, 1, 1, dtype=torch.uint8), rig)
