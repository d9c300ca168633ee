import math

import numpy as np
import pytest
import torch

from omniocc.geometry import Cuboid, Cylinder
from rayiou.raycast import trace as tracing

GRIDS = [
    Cylinder(shape=(7, 12, 5), radius_m=(0.0, 14.0), height_m=(-2.0, 3.0)),
    Cylinder(shape=(6, 9, 4), radius_m=(3.0, 12.0), height_m=(-2.0, 2.0)),
    Cylinder(shape=(3, 3, 2), radius_m=(0.0, 6.0), height_m=(-4.0, 4.0)),
    Cuboid(shape=(8, 7, 5), x_m=(-8.0, 8.0), y_m=(-7.0, 7.0), height_m=(-2.0, 3.0)),
]
VOXELS = Cuboid(shape=(200, 200, 16), x_m=(0.0, 200.0), y_m=(0.0, 200.0), height_m=(0.0, 16.0))
TINY_M = 1e-7


def reference(grid, origins, directions):
    """Return cells and distances by sorting all crossings of every surface; midpoints give the cells. In float64."""
    o, d = origins.double().numpy(), directions.double().numpy()
    d = d / np.linalg.norm(d, axis=1, keepdims=True)
    edges = [grid.edges(axis).numpy() for axis in range(3)]
    crossings = [np.zeros((len(o), 1))]
    with np.errstate(all="ignore"):
        flat_axes = range(3) if isinstance(grid, Cuboid) else [2]
        crossings += [(edges[axis] - o[:, axis : axis + 1]) / d[:, axis : axis + 1] for axis in flat_axes]
        if isinstance(grid, Cylinder):
            sin, cos = np.sin(edges[1]), np.cos(edges[1])
            crossings.append((o[:, :1] * sin - o[:, 1:2] * cos) / (d[:, 1:2] * cos - d[:, :1] * sin))
            a = (d[:, :2] ** 2).sum(1, keepdims=True)
            b = (o[:, :2] * d[:, :2]).sum(1, keepdims=True)
            root = np.sqrt(b**2 - a * ((o[:, :2] ** 2).sum(1, keepdims=True) - edges[0] ** 2))
            crossings += [(-b - root) / a, (-b + root) / a]
    t = np.concatenate(crossings, axis=1)
    t = np.sort(np.where((t >= 0) & (t < 1e4), t, 1e4), axis=1)
    middle = (t[:, 1:] + t[:, :-1]) / 2
    points = o[:, None] + middle[..., None] * d[:, None]
    cell, inside = grid.flat_index(torch.from_numpy(points))
    cell = np.where(inside.numpy(), cell.numpy(), -1)
    for ray in range(len(o)):
        row = []
        for k in range(cell.shape[1]):
            if t[ray, k + 1] - t[ray, k] < TINY_M:
                continue
            if row and row[-1][0] == cell[ray, k]:
                row[-1][2] = t[ray, k + 1]
            else:
                row.append([cell[ray, k], t[ray, k], t[ray, k + 1]])
        yield [(c, first, last) for c, first, last in row if c >= 0]


def compare(grid, origins, directions):
    """Compare every path; return the largest difference of a boundary in metres."""
    found, worst = grid.paths(origins, directions), 0.0
    for ray, expected in enumerate(reference(grid, origins, directions)):
        keep = (found.cells[ray] >= 0) & (found.exit_m[ray] - found.entry_m[ray] > TINY_M)
        assert found.cells[ray][keep].tolist() == [cell for cell, _, _ in expected], (origins[ray], directions[ray])
        only_in_the_hole = not expected and grid.bounds[0][0] > 0 and bool(found.valid[ray])
        assert bool(found.valid[ray]) == (bool(expected) or only_in_the_hole)
        if expected:
            bounds = np.array([(first, last) for _, first, last in expected])
            ours = torch.stack([found.entry_m[ray][keep], found.exit_m[ray][keep]], dim=1).numpy()
            worst = max(worst, float(np.abs(bounds - ours).max()))
    return worst


def random_rays(count, seed, spread_m=20.0):
    generator = torch.Generator().manual_seed(seed)
    origins = (torch.rand(count, 3, generator=generator, dtype=torch.float64) - 0.5) * torch.tensor(
        [spread_m] * 2 + [8]
    )
    directions = torch.randn(count, 3, generator=generator, dtype=torch.float64)
    directions[: count // 2, 2] *= 0.1
    return origins, directions


@pytest.mark.parametrize("grid", GRIDS)
def test_random_rays_agree_with_sorted_crossings(grid):
    assert compare(grid, *random_rays(1500, seed=0)) < 4e-6  # distances are stored in float32
    assert compare(grid, *random_rays(500, seed=1, spread_m=80.0)) < 4e-6


@pytest.mark.parametrize("grid", GRIDS)
def test_rays_from_the_ego_origin(grid):
    _, directions = random_rays(500, seed=2)
    assert compare(grid, torch.zeros(500, 3, dtype=torch.float64), directions) < 4e-6


@pytest.mark.parametrize("grid", GRIDS)
def test_vertical_rays(grid):
    origins, directions = random_rays(200, seed=3)
    directions[:, :2] = 0
    assert compare(grid, origins, directions) < 4e-6


@pytest.mark.parametrize("grid", GRIDS)
def test_horizontal_rays_and_rays_along_one_axis(grid):
    origins, directions = random_rays(200, seed=4)
    directions[:, 2] = 0
    assert compare(grid, origins, directions) < 4e-6
    directions[:, 1] = 0
    assert compare(grid, origins, directions) < 4e-6


@pytest.mark.parametrize("grid", GRIDS)
def test_rays_from_faces(grid):
    generator = torch.Generator().manual_seed(5)
    _, directions = random_rays(300, seed=6)
    values = [edges[torch.randint(len(edges) - 1, (300,), generator=generator)] for edges in map(grid.edges, range(3))]
    free = [torch.rand(300, generator=generator, dtype=torch.float64) * 1.7 + 0.1 for _ in range(3)]
    for axis in range(3):
        mixed = [values[i] if i == axis else values[i] * 0.5 + free[i] for i in range(3)]
        assert compare(grid, grid.from_axes(*mixed), directions) < 4e-6


def test_rays_through_the_axis_change_to_the_opposite_sector():
    grid = Cylinder(shape=(2, 8, 1), radius_m=(0.0, 2.0), height_m=(-1.0, 1.0))
    angle = torch.tensor(0.3, dtype=torch.float64)
    direction = torch.stack([angle.cos(), angle.sin(), torch.zeros(())]).double()
    found = grid.paths(-1.5 * direction[None], direction[None])
    sectors = [(cell // 8, cell % 8) for cell in found.cells[0].tolist()]
    assert sectors == [(1, 0), (0, 0), (0, 4), (1, 4)]
    torch.testing.assert_close(found.bounds_m[0], torch.tensor([0.0, 0.5, 1.5, 2.5, 3.5]), rtol=0, atol=1e-6)


@pytest.mark.parametrize("offset", [0.0, 1e-3, 1e-8, 1e-12, 1e-17])
def test_passing_close_to_the_axis_loses_no_distance(offset):
    grid = Cylinder(shape=(5, 12, 2), radius_m=(0.0, 5.0), height_m=(-1.0, 1.0))
    found = grid.paths(torch.tensor([[-7.0, offset, 0.1]], dtype=torch.float64), torch.tensor([[1.0, 0.0, 0.0]]))
    length = torch.where(found.cells >= 0, found.exit_m - found.entry_m, 0.0).sum().item()
    assert length == pytest.approx(10.0, abs=1e-5)
    assert (found.entry_m[:, 1:] >= found.exit_m[:, :-1]).all()


@pytest.mark.parametrize("grid", GRIDS)
def test_trace_agrees_with_paths(grid):
    generator = torch.Generator().manual_seed(7)
    origins, directions = random_rays(2000, seed=8)
    labels = torch.randint(1, 12, grid.shape, generator=generator, dtype=torch.uint8)
    labels[torch.rand(grid.shape, generator=generator) < 0.85] = 0
    found = grid.paths(origins, directions)
    for hit in ("exit", "entry"):
        range_m, label = grid.trace(labels, origins, directions, hit=hit)
        for ray in range(len(origins)):
            expected = (math.inf if not found.valid[ray] else found.bounds_m[ray, -1].item(), 0)
            for cell, entry_m, exit_m in zip(
                found.cells[ray].tolist(), found.entry_m[ray].tolist(), found.exit_m[ray].tolist(), strict=True
            ):
                if cell >= 0 and labels.flatten()[cell] != 0:
                    expected = (exit_m if hit == "exit" else entry_m, int(labels.flatten()[cell]))
                    break
            assert (range_m[ray].item(), label[ray].item()) == expected


def test_golden_values_of_the_public_kernel():
    """Compare in units of voxels; rays that never enter are invalid here, while the kernel reports voxel (0, 0, 0)."""
    empty = torch.zeros(VOXELS.shape, dtype=torch.uint8)
    wall = empty.clone()
    wall[150] = 3
    at_origin = wall.clone()
    at_origin[100, 100, 8] = 2
    middle, above, outside = [100.5, 100.5, 8.5], [100.5, 100.5, 20.0], [-1.5, 100.5, 8.5]
    forward, up = [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]
    cases = [
        (empty, middle, forward, "exit", 99.5, 0),
        (wall, middle, forward, "exit", 50.5, 3),
        (wall, middle, forward, "entry", 49.5, 3),
        (at_origin, middle, forward, "exit", 0.5, 2),
        (at_origin, middle, forward, "entry", 0.0, 2),
        (wall, above, up, "exit", math.inf, 0),
        (wall, outside, forward, "exit", 152.5, 3),
    ]
    for labels, origin, direction, hit, range_m, label in cases:
        found = VOXELS.trace(labels, torch.tensor([origin]), torch.tensor([direction]), hit=hit)
        assert (found[0].item(), found[1].item()) == (range_m, label)


def test_unknown_cells_stop_a_ray_and_long_directions_change_nothing():
    labels = torch.zeros(VOXELS.shape, dtype=torch.uint8)
    labels[110] = 255
    range_m, label = VOXELS.trace(labels, torch.tensor([[100.5, 100.5, 8.5]]), torch.tensor([[7.0, 0.0, 0.0]]))
    assert (range_m.item(), label.item()) == (10.5, 255)


def test_chunks_do_not_matter(monkeypatch):
    origins, directions = random_rays(500, seed=9)
    whole = GRIDS[0].paths(origins, directions)
    monkeypatch.setattr(tracing, "CHUNK_RAYS", 64)
    for mine, theirs in zip(GRIDS[0].paths(origins, directions), whole, strict=True):
        assert torch.equal(mine, theirs)


def test_no_rays_and_wrong_shape():
    nothing = torch.zeros(0, 3)
    assert GRIDS[0].paths(nothing, nothing).cells.shape == (0, 0)
    with pytest.raises(ValueError, match=r"labels.*\(7, 12, 5\).*\(7, 12, 4\)"):
        GRIDS[0].trace(torch.zeros(7, 12, 4, dtype=torch.uint8), nothing, nothing)
