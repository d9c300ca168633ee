import inspect
from types import SimpleNamespace

import pytest
import torch
from torch import nn

from omniocc.camera import Rig
from omniocc.config import build
from omniocc.data.dataset import Sample
from omniocc.runs.cost import GFLOP, PARAMETERS, cost_of, count_gflop, estimates_range


def test_a_product_counts_multiplications_and_additions():
    left, right = torch.rand(30, 40), torch.rand(40, 50)
    assert count_gflop(lambda: left @ right) == pytest.approx(2 * 30 * 40 * 50 / 1e9)


def test_a_bag_counts_one_row_for_every_entry():
    table, rows, weights = torch.rand(100, 8), torch.randint(0, 100, (5, 7)), torch.rand(5, 7)
    bag = torch.nn.functional.embedding_bag
    assert count_gflop(lambda: bag(rows, table, mode="sum", per_sample_weights=weights)) == pytest.approx(560e-9)


@pytest.mark.filterwarnings("ignore:Sparse CSR:UserWarning")
def test_only_stored_entries_of_a_sparse_matrix_count():
    sparse = torch.eye(30).to_sparse_csr()
    assert count_gflop(lambda: sparse @ torch.rand(30, 6)) == pytest.approx(2 * 30 * 6 / 1e9)


def make_sample(geometry, frames, fraction):
    """A recorded frame of noise, with a fraction of the voxels as candidates."""
    poses = torch.eye(4, dtype=torch.float64).repeat(frames, 1, 1)
    return Sample(
        images=torch.randint(0, 256, (frames, 6, 3, 36, 64), dtype=torch.uint8),
        rigs=(Rig.load("fisheye6").resized(64, 36),) * frames,
        world_from_ego=poses,
        voxels=torch.zeros(geometry.shape, dtype=torch.uint8),
        pixel_labels=torch.zeros(6, 36, 64, dtype=torch.uint8),
        lidar_range_m=torch.ones(14040),
        lidar_labels=torch.zeros(14040, dtype=torch.uint8),
        frame_id="street/000000",
        candidates=None if fraction is None else torch.rand(frames, *geometry.shape) < fraction,
    )


@pytest.fixture
def make_model(smoke):
    return lambda *overrides: build(smoke(*overrides).model).eval()


def test_a_frame_costs_the_same_every_time_and_more_with_more_candidates(make_model):
    model = make_model()
    torch.manual_seed(0)
    few, many = (make_sample(model.geometry, model.temporal.frames, fraction) for fraction in (0.1, 0.9))
    cost = cost_of(model, few)
    assert cost == cost_of(model, few)
    assert cost[PARAMETERS] == pytest.approx(sum(p.numel() for p in model.parameters()) / 1e6, abs=1e-3)
    assert cost_of(model, many)[GFLOP] > cost[GFLOP]


def test_depth_is_part_of_the_cost_unless_it_was_recorded(make_model):
    predicted, recorded = make_model(), make_model("model/depth=truth")
    sample = make_sample(predicted.geometry, predicted.temporal.frames, 0.3)
    assert cost_of(predicted, sample)[GFLOP] > cost_of(recorded, sample)[GFLOP] > 0


class OnDepth(nn.Module):
    """A learned sketch whose depth is a registered submodule, which `isinstance` with a protocol may not see."""

    def __init__(self, recorded):
        super().__init__()
        self.depth = nn.Identity()
        self.depth.NEEDS_TRUE_RANGE = recorded

    def weighted_losses(self, range_m, valid, voxels):
        return {}


@pytest.mark.parametrize("recorded", [False, True])
def test_depth_that_is_a_submodule_is_found(recorded):
    sketch = OnDepth(recorded)
    with pytest.raises(AttributeError):
        inspect.getattr_static(sketch, "depth")
    assert estimates_range(SimpleNamespace(sketch=sketch)) != recorded


def test_sketches_without_depth_need_no_candidates(make_model):
    model = make_model("model/sketch=random")
    assert cost_of(model, make_sample(model.geometry, model.temporal.frames, None))[GFLOP] > 0
