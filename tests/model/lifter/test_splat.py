import math
from dataclasses import replace

import pytest
import torch

from omniocc.camera import Rig
from omniocc.geometry import Cuboid, Cylinder
from omniocc.model.lifter.lift_splat import bin_points, find_entries, splat

CPU = torch.device("cpu")
RANGES_M = (1.0, 3.0, 5.5, 9.0)
GRIDS = [Cylinder((4, 7, 3), (0.0, 6.0), (-3.0, 3.0)), Cuboid((5, 4, 3), (-6.0, 6.0), (-4.0, 5.0), (-3.0, 3.0))]


@pytest.fixture
def fisheye(fisheye):
    """Return the rig without the masks of its own car, which the loops do not know."""
    return replace(fisheye, masks=None)


@pytest.fixture
def pinhole(pinhole):
    """Return the rig without the masks of its own car, which the loops do not know."""
    return replace(pinhole, masks=None)


def cell_by_hand(grid, point):
    """Index along each axis by floor, or None outside."""
    x, y, z = point
    values = (math.hypot(x, y), math.atan2(y, x), z) if isinstance(grid, Cylinder) else (x, y, z)
    cell = []
    for value, (low, high), cells in zip(values, grid.bounds, grid.shape, strict=True):
        index = math.floor((value - low) / (high - low) * cells)
        if not 0 <= index < cells:
            return None
        cell.append(index)
    return tuple(cell)


def splat_by_loops(context, probability, rig, grid, height, width):
    """(C, *shape): every camera, pixel and bin on its own."""
    volume = torch.zeros(context.shape[1], *grid.shape, dtype=torch.float64)
    for camera, model in enumerate(rig.cameras):
        for row in range(height):
            for column in range(width):
                pixel = (camera * height + row) * width + column
                u = (column + 0.5) * model.width / width - 0.5
                v = (row + 0.5) * model.height / height - 0.5
                ray, valid = model.unproject(torch.tensor([u, v], dtype=torch.float64))
                for index, range_m in enumerate(RANGES_M if valid else ()):
                    point = rig.ego_from_camera[camera] @ torch.cat([ray * range_m, torch.ones(1, dtype=torch.float64)])
                    cell = cell_by_hand(grid, point[:3].tolist())
                    if cell is not None:
                        volume[(slice(None), *cell)] += probability[pixel, index] * context[pixel]
    return volume


@pytest.mark.parametrize("grid", GRIDS, ids=["cylinder", "cuboid"])
@pytest.mark.parametrize("name", ["fisheye", "pinhole"])
def test_equals_loops_over_cameras_pixels_and_bins(request, name, grid):
    rig = request.getfixturevalue(name)
    context = torch.randn(6 * 4 * 8, 5, dtype=torch.float64)
    probability = torch.rand(6 * 4 * 8, len(RANGES_M), dtype=torch.float64)
    volume = splat(context, probability, find_entries(rig, grid, 4, 8, RANGES_M, CPU)).T.reshape(5, *grid.shape)
    expected = splat_by_loops(context, probability, rig, grid, 4, 8)
    assert expected.abs().sum() > 0
    torch.testing.assert_close(volume, expected)


def test_points_lie_at_their_range_from_the_camera_also_behind_its_plane(fisheye):
    points_m, seen = bin_points(fisheye, 9, 16, torch.tensor(RANGES_M, dtype=torch.float64))
    points_m, seen = points_m.view(6, -1, len(RANGES_M), 3), seen.view(6, -1)
    local = points_m - fisheye.ego_from_camera[:, None, None, :3, 3]
    expected = torch.tensor(RANGES_M, dtype=torch.float64).expand(local.shape[:-1])
    torch.testing.assert_close(local.norm(dim=-1)[seen], expected[seen])
    forward = torch.einsum("npbk,nk->npb", local, fisheye.ego_from_camera[:, :3, 2])
    assert (forward[..., 0][seen] < 0).any()


def test_mass_is_conserved_where_the_grid_holds_all_points(fisheye):
    grid = Cuboid((6, 6, 6), (-20.0, 20.0), (-20.0, 20.0), (-20.0, 20.0))
    context, probability = (
        torch.randn(6 * 36, 5, dtype=torch.float64),
        torch.rand(6 * 36, 4, dtype=torch.float64).softmax(-1),
    )
    seen = bin_points(fisheye, 4, 9, torch.tensor(RANGES_M, dtype=torch.float64))[1]
    volume = splat(context, probability, find_entries(fisheye, grid, 4, 9, RANGES_M, CPU))
    torch.testing.assert_close(volume.sum(0), context[seen].sum(0))


def test_nothing_leaks_in_from_just_outside():
    """A pixel looks along +x from x = -0.3: truncation would put the bin at -0.2 into the cell that begins at 0."""
    rig = Rig.load("pinhole6").resized(64, 36)
    front = max(range(6), key=lambda index: float(rig.ego_from_camera[index, 0, 2]))
    place = rig.ego_from_camera[front, :3, 3]
    start_m = float(place[0]) + 0.3
    grid = Cuboid((4, 1, 1), (start_m, start_m + 4.0), (-50.0, 50.0), (-50.0, 50.0))
    entries = find_entries(rig, grid, 1, 1, (0.1, 0.2), CPU)
    assert not (entries.slot // 2 == front).any()
    reached = find_entries(rig, grid, 1, 1, (0.1, 0.5), CPU)
    assert (reached.slot // 2 == front).sum() == 1


def test_masked_pixels_give_nothing(fisheye):
    masks = tuple(torch.ones(36, 64, dtype=torch.bool) for _ in range(6))
    masks[2][:, :32] = False
    masked = Rig(fisheye.cameras, fisheye.ego_from_camera, fisheye.names, masks)
    seen = bin_points(masked, 9, 16, torch.ones(1, dtype=torch.float64))[1].view(6, 9, 16)
    whole = bin_points(fisheye, 9, 16, torch.ones(1, dtype=torch.float64))[1].view(6, 9, 16)
    assert not seen[2, :, :8].any()
    assert torch.equal(seen[2, :, 8:], whole[2, :, 8:])
    assert torch.equal(seen[[0, 1, 3, 4, 5]], whole[[0, 1, 3, 4, 5]])


@pytest.mark.parametrize("grid", GRIDS, ids=["cylinder", "cuboid"])
def test_gradients_are_those_of_finite_differences(fisheye, grid):
    context = torch.randn(6 * 6, 2, dtype=torch.float64, requires_grad=True)
    probability = torch.rand(6 * 6, len(RANGES_M), dtype=torch.float64, requires_grad=True)
    entries = find_entries(fisheye, grid, 2, 3, RANGES_M, CPU)
    assert len(entries.voxel) > len(entries.voxel.unique())
    assert torch.autograd.gradcheck(lambda *inputs: splat(*inputs, entries), (context, probability), fast_mode=True)
