import math

import numpy as np
import pytest
import torch

from omniocc.errors import UserError
from omniocc.geometry import Cuboid, Cylinder
from omniocc.loss import Dice, LidarRays, RayLoss, Rays, RayWindow, Semantics
from omniocc.loss.lidar_rays import draw_rays

GRID = Cuboid((6, 5, 4), (-3.0, 3.0), (-2.5, 2.5), (-1.0, 1.0))
LOW, HIGH, CELL = np.array([-3, -2.5, -1.0]), np.array([3, 2.5, 1.0]), np.array([1, 1, 0.5])
LINE = Cuboid((8, 1, 1), (0.0, 8.0), (-1.0, 1.0), (-1.0, 1.0))


def rays_of(*rows):
    """Return one sample of rays, each (origin, end, label)."""
    origins, ends, labels = zip(*rows, strict=True)
    tensors = (torch.tensor(part, dtype=torch.float32)[None] for part in (origins, ends))
    return Rays(*tensors, torch.tensor([labels], dtype=torch.uint8))


def random_rays(rays=40):
    torch.manual_seed(3)
    origins = torch.rand(2, rays, 3) - 0.5
    ends = origins + 2 * torch.randn(2, rays, 3) * torch.tensor([1.0, 1.0, 0.3])
    labels = torch.tensor([0, 1, 2, 255], dtype=torch.uint8)[torch.randint(0, 4, (2, rays))]
    origins[0, -5:] = ends[0, -5:] = math.nan
    labels[0, -5:] = 255
    return Rays(origins, ends, labels)


def cell_of(point):
    index = np.floor((point - LOW) / CELL).astype(int)
    return tuple(index) if all(0 <= i < n for i, n in zip(index, GRID.shape, strict=True)) else None


def leaves_at(origin, direction):
    """Return the distance at which a ray from inside of the grid leaves it."""
    return min(((HIGH if d > 0 else LOW)[k] - origin[k]) / d for k, d in enumerate(direction) if d)


def reference(logits, rays, number, queries, free_weight, seed):
    """Return the loss in loops over rays and places, with the same draws."""
    draws = torch.Generator().manual_seed(seed)
    order = torch.rand(rays.labels.shape, generator=draws).numpy()
    used = min(number, order.shape[1])
    jitter = torch.rand(len(order), used, queries, generator=draws).numpy()
    hits, free = [], []
    for sample, (origins, ends, labels) in enumerate(zip(*(part.numpy() for part in rays), strict=True)):
        probability = torch.softmax(logits[sample].double(), 0).numpy()
        known = [ray for ray in range(len(labels)) if np.isfinite(origins[ray]).all()]
        occupied = {cell_of(ends[ray].astype(float)) for ray in known if labels[ray] != 0}
        for place, ray in enumerate(sorted(known, key=lambda ray: order[sample, ray])[:used]):
            origin, end = origins[ray].astype(float), ends[ray].astype(float)
            direction, length = (end - origin) / np.linalg.norm(end - origin), np.linalg.norm(end - origin)
            cell = cell_of(end)
            if labels[ray] != 0 and cell is not None:
                column = probability[(slice(None), *cell)]
                hits.append(-math.log(1 - column[0] if labels[ray] == 255 else column[labels[ray]]))
            last = min(leaves_at(origin, direction), length - (0.5 if labels[ray] != 0 else 0.0))
            for query in range(queries):
                if last <= 0:
                    continue
                at = last * (query + jitter[sample, place, query]) / queries
                cell = cell_of(origin + at * direction)
                if cell is not None and cell not in occupied:
                    free.append(-math.log(probability[(0, *cell)]))
    assert len(hits) > 10
    assert len(free) > 60
    return np.mean(hits) + free_weight * np.mean(free)


@pytest.mark.parametrize("number", [1000, 25])
@pytest.mark.parametrize("free_weight", [1.0, 0.3])
def test_the_loss_is_that_of_loops(number, free_weight):
    rays, logits = random_rays(), 2 * torch.randn(2, 3, *GRID.shape)
    value = LidarRays(GRID, number, 4, free_weight)(logits, rays, torch.Generator().manual_seed(7))
    assert float(value) == pytest.approx(reference(logits, rays, number, 4, free_weight, 7), rel=1e-5)


def gradient(rays, classes=3, queries=16):
    logits = torch.zeros(1, classes, *LINE.shape, requires_grad=True)
    LidarRays(LINE, 10, queries, 1.0)(logits, rays, torch.Generator().manual_seed(0)).backward()
    return logits.grad[0, :, :, 0, 0]


def test_before_a_hit_is_free_the_hit_is_occupied_and_behind_it_nothing_is_known():
    found = gradient(rays_of([(0.0, 0, 0), (5.5, 0, 0), 2]))
    assert (found[0, :5] < 0).all(), "descent raises the logit of free"
    assert (found[1:, :5] > 0).all()
    assert found[2, 5] < 0
    assert (found[:2, 5] > 0).all()
    assert not found[:, 6:].any()


def test_the_half_cell_before_a_hit_is_neither():
    for end_m, last in ((5.2, 4), (5.9, 4), (4.4, 3)):  # the second ends in a cell that it enters 0.9 m before
        found = gradient(rays_of([(0.0, 0, 0), (end_m, 0, 0), 1]), queries=200)
        assert found[0, last] < 0
    short = gradient(rays_of([(0.0, 0, 0), (5.2, 0, 0), 1]), queries=400)[0]
    assert float(short[4] / short[3]) == pytest.approx(0.7, abs=0.02), "0.7 m of it lie more than half a cell before"


def test_a_hit_of_unknown_class_is_occupied_by_any():
    found = gradient(rays_of([(0.0, 0, 0), (5.5, 0, 0), 255]))
    assert found[0, 5] > 0
    assert (found[1:, 5] < 0).all()
    torch.testing.assert_close(found[1, 5], found[2, 5])


def test_a_ray_without_a_hit_is_free_up_to_its_end():
    found = gradient(rays_of([(0.0, 0, 0), (6.5, 0, 0), 0]), queries=100)
    assert (found[0, :7] < 0).all()
    assert not found[:, 7].any()
    assert (gradient(rays_of([(0.0, 0, 0), (1000.0, 0, 0), 0]))[0] < 0).all()


def test_a_cell_with_a_hit_is_not_free_for_other_rays():
    found = gradient(rays_of([(0.0, 0, 0), (7.5, 0, 0), 1], [(3.5, 0.9, 0), (3.5, 0.1, 0), 2]))
    assert found[2, 3] < 0
    assert found[0, 3] > 0
    assert (found[0, [0, 1, 2, 4, 5]] < 0).all()


def test_rays_that_are_padded_or_miss_the_grid_give_nothing():
    for rays in (
        rays_of([(math.nan,) * 3, (math.nan,) * 3, 255]),
        rays_of([(0.0, 5, 0), (8.0, 5, 0), 1], [(3.0, 0, 0), (3.0, 0, 0), 0]),
    ):
        assert not gradient(rays).any()


def test_rays_are_drawn_anew_and_padded_ones_last():
    rays, generator = random_rays(), torch.Generator().manual_seed(0)
    first, second = draw_rays(rays, 10, generator), draw_rays(rays, 10, generator)
    assert first.labels.shape == (2, 10)
    assert not torch.equal(first.ends_m, second.ends_m)
    assert first.ends_m.isfinite().all()
    everything = draw_rays(rays, 100, generator)
    assert everything.ends_m.isfinite().all(-1).sum(-1).tolist() == [35, 40]


@pytest.mark.parametrize("dtype", [torch.float32, torch.bfloat16])
def test_descent_finds_what_was_measured(dtype):
    grid = Cylinder((8, 12, 4), (0.0, 8.0), (-2.0, 2.0))
    torch.manual_seed(0)
    directions = torch.nn.functional.normalize(torch.randn(1, 300, 3) * torch.tensor([1.0, 1.0, 0.1]), dim=-1)
    rays = Rays(torch.zeros(1, 300, 3), 5.3 * directions, torch.randint(1, 4, (1, 300), dtype=torch.uint8))
    logits = torch.zeros(1, 4, *grid.shape, requires_grad=True)
    loss, optimizer = LidarRays(grid, 200, 8, 1.0), torch.optim.Adam([logits], 0.3)
    generator = torch.Generator().manual_seed(0)
    for _ in range(80):
        optimizer.zero_grad()
        with torch.autocast("cpu", torch.bfloat16, enabled=dtype != torch.float32):
            value = loss(logits.to(dtype), rays, generator)
        value.backward()
        optimizer.step()
    assert value.dtype == torch.float32
    cells, inside = grid.flat_index(rays.ends_m[0])
    found = logits.detach()[0].flatten(1).argmax(0)
    assert (found[cells[inside]] > 0).all()
    near = grid.flat_index(rays.ends_m[0] / 2)[0]
    assert (found[near] == 0).float().mean() > 0.95


def test_a_window_has_its_own_frame_once():
    for frames in ([], [1], [0, 1, 1]):
        with pytest.raises(ValueError, match="give 0, the newest frame"):
            RayWindow(frames, True)


def ray_loss(weights):
    return RayLoss({}, {"semantics": Semantics()}, weights, {"rays": LidarRays(LINE, 10, 4, 1.0)}, RayWindow([0], True))


def test_a_batch_without_rays_is_one_line():
    with pytest.raises(UserError, match=r"^loss=lidar_rays needs LiDAR scans.*$") as caught:
        ray_loss({"semantics": 1.0, "rays": 2.0}).ray_terms(torch.zeros(1, 3, *LINE.shape), None, torch.Generator())
    assert "\n" not in str(caught.value)


def test_terms_of_voxels_need_classes():
    with pytest.raises(ValueError, match=r"rays\.classes is false, but terms of voxels need classes"):
        RayLoss({"dice": Dice()}, {}, {"dice": 1.0}, {}, RayWindow([0], False))


def test_terms_of_rays_have_names_and_weights():
    with pytest.raises(ValueError, match="same names"):
        ray_loss({"semantics": 1.0})
    rays = rays_of([(0.0, 0, 0), (5.5, 0, 0), 2])
    logits, draws = torch.randn(1, 3, *LINE.shape), torch.Generator
    terms = ray_loss({"semantics": 1.0, "rays": 2.0}).ray_terms(logits, rays, draws().manual_seed(0))
    plain = LidarRays(LINE, 10, 4, 1.0)(logits, rays, draws().manual_seed(0))
    assert list(terms) == ["rays"]
    torch.testing.assert_close(terms["rays"], 2 * plain)
