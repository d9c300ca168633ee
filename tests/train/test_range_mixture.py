"""Better and worse ranges in the training of sketch and occupancy."""

import pytest
import torch
from batches import make_batch

from omniocc.data import RangeMixture
from omniocc.parts import Parts
from omniocc.train.adamw import AdamW
from omniocc.train.occupancy import with_other_ranges
from omniocc.train.sketch import SketchTask, finite_ranges

TRUE = RangeMixture(1, 0, 0.1)


@pytest.fixture
def batch(make_task):
    def make(task):
        panorama = task.model.sketch.panorama
        shape = 2, panorama.height, panorama.width
        parts = {"depth_range_m": torch.full(shape, 3.0), "erp_range_m": torch.full(shape, 8.0)}
        return make_batch(task, [(0, 2), (1, 2)])._replace(**parts)

    return make


def test_the_sketch_finds_the_newest_candidates_anew_in_true_ranges(make_task, batch):
    task = make_task("model=extended").eval()
    before = batch(task)

    after = with_other_ranges(before, task.model.sketch, TRUE, torch.Generator().manual_seed(0))

    expected = task.model.sketch.propose(*finite_ranges(before.erp_range_m))
    assert torch.equal(after.candidates[:, -1], expected.candidates)
    assert torch.equal(after.evidence[:, -1], expected.bits)
    assert not torch.equal(after.evidence[:, -1], before.evidence[:, -1])
    assert torch.equal(after.evidence[:, :-1], before.evidence[:, :-1])


@pytest.mark.parametrize("absent", ["depth_range_m", "candidates"])
def test_a_batch_without_stored_ranges_or_candidates_stays(absent, make_task, batch):
    task = make_task("model=extended")
    before = batch(task)._replace(**{absent: None})

    assert with_other_ranges(before, task.model.sketch, TRUE, torch.Generator()) is before


def test_a_training_step_takes_the_ranges_of_the_mixture(make_task, batch, monkeypatch):
    task = make_task("model=extended", "+range_mixture=good_and_bad", "range_mixture.true_fraction=1")
    monkeypatch.setattr(task, "log", lambda *_, **__: None)
    monkeypatch.setattr(task, "log_dict", lambda *_, **__: None)
    given = batch(task)
    mixed = task.training_step(given, 0)
    task.mixture = None
    assert mixed.isfinite()
    assert not torch.equal(mixed, task.training_step(given, 0))


def test_the_sketch_stage_learns_from_the_same_mixture(smoke, make_task, batch, monkeypatch):
    parts = Parts(smoke("+range_mixture=good_and_bad", "range_mixture.true_fraction=1"))
    sketch, optimizer = parts.sketch(), parts.recipe("sketch").optimizer
    assert isinstance(optimizer, AdamW)
    task = SketchTask(sketch, optimizer, (0.0, 8.5), {}, parts.range_mixture(), 0)
    monkeypatch.setattr(task, "log", lambda *_, **__: None)
    monkeypatch.setattr(task, "log_dict", lambda *_, **__: None)
    seen, losses = [], sketch.weighted_losses
    monkeypatch.setattr(sketch, "weighted_losses", lambda *inputs: seen.append(inputs) or losses(*inputs))

    task.training_step(batch(make_task("model=extended")), 0)

    assert seen[0][0].unique().tolist() == [8.0]
