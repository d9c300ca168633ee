import inspect
from typing import NamedTuple

import pytest
import torch
from torch import nn

from omniocc.camera import Equirectangular
from omniocc.geometry import Cuboid, Cylinder
from omniocc.model.ops.sketch import pseudo_points
from omniocc.model.sketch import Dense, Omni, Random, Sketch, learns
from omniocc.model.sketch.omni import choose_likeliest, occupancy

PANORAMA = Equirectangular(24, 12, 45.0, -45.0)


class Seen(NamedTuple):
    range_m: torch.Tensor
    valid: torch.Tensor


class FakeDepth(nn.Module):
    """Ranges from a weight and the true ones, so that gradients and modes can be seen."""

    NEEDS_TRUE_RANGE = False

    def __init__(self):
        super().__init__()
        self.panorama = PANORAMA
        self.scale = nn.Parameter(torch.tensor(2.0))
        self.norm = nn.BatchNorm2d(3)

    def rig_spheres(self, rig):
        raise NotImplementedError

    def forward(self, images, rigs, true_range_m=None):
        self.norm(images.flatten(0, 1))
        base = images.mean((1, 2, 3, 4))[:, None, None].expand(-1, 12, 24) if true_range_m is None else true_range_m
        return Seen(self.scale * base, base < 15)


def make(geometry, threshold: float | None = 0.5, fraction=None, windows=(0, 0, 0), dilation_behind_m=0.0):
    return Omni(
        geometry, FakeDepth(), 8, [1, 2, 2], [8, 8, 16], threshold, fraction, windows, [8.5, 17.0], dilation_behind_m
    )


def scene(batch=2):
    return torch.rand(batch, 12, 24) * 20 + 1, torch.rand(batch, 12, 24) < 0.8


def labels(geometry, batch=2):
    return torch.tensor([0, 0, 3, 9, 255], dtype=torch.uint8)[torch.randint(0, 5, (batch, *geometry.shape))]


def test_it_is_a_sketch(geometry, fisheye):
    sketch = make(geometry)
    images, range_m = torch.rand(2, 6, 3, 4, 4), torch.rand(2, 12, 24) * 20 + 1
    candidates, bits = sketch(images, (fisheye, fisheye), range_m)
    assert bits.shape == (2, *geometry.shape)
    assert bits.dtype == torch.uint8
    assert isinstance(sketch, Sketch)
    assert learns(type(sketch))
    assert candidates.shape == (2, *geometry.shape)
    assert candidates.dtype == torch.bool


def test_the_class_shows_whether_it_learns_and_its_selection():
    assert [learns(option) for option in (Omni, Dense, Random)] == [True, False, False]
    assert set(Omni.SELECTION) < set(inspect.signature(Omni).parameters)


def test_forward_is_depth_then_logits_then_select(geometry, fisheye):
    sketch = make(geometry).eval()
    truth = torch.rand(2, 12, 24) * 20 + 1
    expected = sketch.candidates(sketch.logits(2 * truth, truth < 15))
    assert torch.equal(sketch(torch.rand(2, 6, 3, 4, 4), (fisheye, fisheye), truth).candidates, expected)


def test_a_batch_of_two_is_two_batches_of_one(geometry):
    sketch = make(geometry)
    range_m, valid = scene()
    apart = torch.cat([sketch.logits(range_m[i : i + 1], valid[i : i + 1]) for i in range(2)])
    assert torch.allclose(sketch.logits(range_m, valid), apart, atol=1e-5)


def test_turning_the_panorama_turns_the_sketch():
    grid = Cylinder((8, 12, 4))
    sketch = make(grid)
    range_m, valid = scene()
    # 4 cells counter-clockwise are 8 pixels to the left
    turned = sketch.logits(range_m.roll(-8, 2), valid.roll(-8, 2))
    assert torch.allclose(turned, sketch.logits(range_m, valid).roll(4, 3), atol=1e-4)


def test_ranges_of_invalid_pixels_are_ignored(geometry):
    sketch = make(geometry)
    range_m, valid = scene()
    other = torch.where(valid, range_m, torch.tensor(torch.inf))
    other[:, 0] = torch.where(valid[:, 0], range_m[:, 0], torch.nan)
    assert torch.equal(sketch.logits(range_m, valid), sketch.logits(other, valid))
    changed = torch.where(valid, range_m + 3, range_m)
    assert not torch.allclose(sketch.logits(range_m, valid), sketch.logits(changed, valid))


def test_a_panorama_without_a_valid_pixel(geometry):
    sketch = make(geometry)
    terms = sketch.weighted_losses(*(scene()[0], torch.zeros(2, 12, 24, dtype=torch.bool)), labels(geometry))
    assert all(term.isfinite() for term in terms.values())
    sum(terms.values()).backward()
    grads = [p.grad for p in sketch.parameters() if p.grad is not None]
    assert grads
    assert all(grad.isfinite().all() for grad in grads)


def test_gradients_reach_every_parameter_but_those_of_depth(geometry):
    sketch = make(geometry)
    terms = sketch.weighted_losses(*scene(), labels(geometry))
    assert set(terms) == {"ce", "lovasz"}
    sum(terms.values()).backward()
    for name, parameter in sketch.named_parameters():
        if name.startswith("depth."):
            assert parameter.grad is None, name
            assert not parameter.requires_grad, name
        else:
            assert parameter.grad is not None, name
            assert parameter.grad.any(), name


def test_depth_stays_frozen_in_evaluation_mode(geometry, fisheye):
    sketch = make(geometry).train()
    assert sketch.network.training
    assert not sketch.depth.training
    before = sketch.depth.norm.running_mean.clone()
    sketch(torch.rand(1, 6, 3, 4, 4), (fisheye,))
    assert torch.equal(sketch.depth.norm.running_mean, before)
    outer = nn.Sequential(sketch)
    outer.train()
    assert not sketch.depth.norm.training


def test_unknown_voxels_do_not_count(geometry):
    sketch = make(geometry)
    range_m, valid = scene()
    voxels = torch.full((2, *geometry.shape), 255, dtype=torch.uint8)
    assert all(term == 0 for term in sketch.weighted_losses(range_m, valid, voxels).values())
    assert occupancy(torch.tensor([[[[0, 1, 11, 255]]]], dtype=torch.uint8)).flatten().tolist() == [0, 1, 1, 255]


def test_cross_entropy_by_hand():
    grid = Cuboid((4, 4, 2))
    sketch = make(grid)
    range_m, valid = scene(1)
    voxels = labels(grid, 1)
    logits = sketch.logits(range_m, valid).detach().double().log_softmax(1)
    known = [(i, v) for i, v in enumerate(voxels.flatten().tolist()) if v != 255]
    expected = -sum(float(logits[0].flatten(1)[int(v > 0), i]) for i, v in known) / len(known)
    assert sketch.weighted_losses(range_m, valid, voxels)["ce"].item() == pytest.approx(expected, rel=1e-4)


def test_learns_to_find_occupied_voxels():
    grid = Cylinder((8, 12, 4))
    sketch = make(grid)
    range_m, valid = torch.full((1, 12, 24), 10.0), torch.ones(1, 12, 24, dtype=torch.bool)
    range_m[:, :, 12:] = 20.0  # right half
    voxels = torch.zeros(1, *grid.shape, dtype=torch.uint8)
    voxels[:, 3, 6:, 1:3] = 5  # 9.6 to 12.8 m, left
    voxels[:, 6, :6, 1:3] = 5  # 19.2 to 22.4 m, right
    optimizer = torch.optim.Adam([p for p in sketch.parameters() if p.requires_grad], lr=1e-2)
    for _ in range(40):
        optimizer.zero_grad()
        sum(sketch.weighted_losses(range_m, valid, voxels).values()).backward()
        optimizer.step()
    found = sketch.candidates(sketch.logits(range_m, valid))
    assert torch.equal(found, voxels > 0)


def test_fraction_is_exact_and_dilation_comes_after(geometry):
    plain = make(geometry, None, 0.2)
    range_m, valid = scene()
    logits = plain.logits(range_m, valid)
    candidates = plain.candidates(logits)
    assert candidates.sum((1, 2, 3)).tolist() == [round(0.2 * geometry.num_cells)] * 2
    step_m = geometry.radial_step_m
    wide = make(geometry, None, 0.2, (0, step_m, 2 * step_m))
    assert torch.equal(wide.undilated_candidates(logits), candidates)
    assert torch.equal(wide.candidates(logits), geometry.dilate(candidates, (0, 1, 2), (8.5, 17.0)))
    assert wide.candidates(logits).sum() > candidates.sum()
    thick = make(geometry, None, 0.2, dilation_behind_m=1.6 * step_m)
    assert torch.equal(thick.candidates(logits), geometry.dilate(candidates, (0, 0, 0), (8.5, 17.0), behind=2))


def test_threshold_is_that_of_the_probability(geometry):
    sketch = make(geometry, 0.3)
    logits = torch.randn(2, 2, *geometry.shape)
    assert torch.equal(sketch.candidates(logits), logits.softmax(1)[:, 1] >= 0.3)


@pytest.mark.parametrize(("threshold", "fraction"), [(None, None), (0.5, 0.2)])
def test_exactly_one_of_threshold_and_fraction(threshold, fraction):
    with pytest.raises(ValueError, match=f"threshold.*{threshold}.*fraction.*{fraction}"):
        make(Cylinder((8, 12, 4)), threshold, fraction)


@pytest.mark.parametrize(("threshold", "fraction"), [(0.0, None), (1.1, None), (None, 0.0), (None, -0.1), (None, 1.5)])
def test_impossible_values_are_named(threshold, fraction):
    with pytest.raises(ValueError, match=f"is {fraction if threshold is None else threshold}"):
        make(Cylinder((8, 12, 4)), threshold, fraction)


def test_windows_are_metres_so_that_finer_grids_widen_as_far():
    edges = (0.0, 25.6)
    coarse, fine = (make(Cylinder((cells, 12, 4), edges), windows=(0.0, 0.4, 0.8)) for cells in (64, 128))
    assert coarse.windows == (0, 1, 2)
    assert fine.windows == (0, 2, 4)
    assert make(Cuboid((128, 128, 4), edges, edges), windows=(0.0, 0.4, 0.8)).windows == (0, 2, 4)


def test_windows_that_do_not_fit_are_named():
    with pytest.raises(ValueError, match="one more window"):
        make(Cylinder((8, 12, 4)), windows=(0, 1))


def test_the_threshold_itself_is_chosen():
    logits = torch.tensor([[0.0, 0.0], [0.0, -0.1], [0.0, 0.1]]).T.reshape(1, 2, 3, 1, 1)
    assert make(Cylinder((8, 12, 4)), 0.5).undilated_candidates(logits).flatten().tolist() == [True, False, True]


@pytest.mark.parametrize(("fraction", "count"), [(0.25, 96), (0.1, 38), (1.0, 384)])
def test_fraction_is_exact_in_every_sample(fraction, count):
    probability = torch.rand(3, 8, 12, 4)
    probability[1] = 0.5  # all equal
    chosen = choose_likeliest(probability, fraction)
    assert chosen.sum((1, 2, 3)).tolist() == [count] * 3


def test_fraction_takes_the_likeliest_of_each_sample():
    probability = torch.rand(2, 8, 12, 4)
    probability[1] *= 0.1
    chosen = choose_likeliest(probability, 0.3)
    for sample in range(2):
        assert probability[sample][chosen[sample]].min() > probability[sample][~chosen[sample]].max()


def test_evidence_is_the_probability_and_what_the_panorama_saw(geometry):
    sketch = make(geometry)
    range_m, valid = scene()
    sketched = sketch.propose(range_m, valid)
    candidates, evidence = sketched.candidates, sketched.evidence()
    logits = sketch.logits(range_m, valid)
    assert torch.equal(candidates, sketch.candidates(logits))
    expected = (logits[:, 1] - logits[:, 0]).clamp(-6.3, 6.3)
    assert float((evidence[:, 0] - expected).detach().abs().max()) <= 0.1 + 1e-5
    hit = sketch.points(pseudo_points(range_m, valid, PANORAMA))[1][:, 0] > 0
    assert torch.equal(evidence[:, 1].bool(), hit)
    known, _, gap, _ = sketch.range_gaps(range_m, valid).unbind(1)
    assert torch.equal(evidence[:, 2].bool(), ~hit & (known > 0) & (gap > 0))
    assert torch.equal(evidence[:, 3].bool(), ~hit & (known > 0) & (gap <= 0))
    assert evidence[:, 1:].sum((0, 2, 3, 4)).min() > 0
