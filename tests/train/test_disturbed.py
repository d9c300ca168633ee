"""Disturbed batches in training: the model computes its candidates, and the depth network believes wrong rigs."""

import pytest
import torch
from batches import RIG, WAYS, always, make_batch

from omniocc.data import Disturbances
from omniocc.errors import UserError
from omniocc.parts import Parts
from omniocc.train.adamw import AdamW
from omniocc.train.depth import DepthTask


@pytest.fixture
def silent(monkeypatch):
    def quiet(task):
        monkeypatch.setattr(task, "log", lambda *_, **__: None)
        monkeypatch.setattr(task, "log_dict", lambda *_, **__: None)
        return task

    return quiet


@pytest.mark.parametrize("way", WAYS)
def test_the_model_computes_the_candidates_of_disturbed_batches(way, make_task, silent, monkeypatch):
    task = silent(make_task("model=extended", "augment=disturbed", *always(way)))
    weights = {name: value.clone() for name, value in task.model.sketch.state_dict().items()}
    task.set_training_statistics(torch.randint(1, 100, (12, *task.model.geometry.shape)))
    asked, propose = [], task.model.propose
    monkeypatch.setattr(task.model, "propose", lambda *inputs: asked.append(inputs) or propose(*inputs))
    loss = task.training_step(make_batch(task, [(0, 2), (1, 2)]), 0)
    loss.backward()
    assert loss.isfinite()
    assert len(asked) == 2, "the newest frames, and all past ones"
    believed = {rig for _, rigs in asked for rig in rigs}
    assert way == "camera" or (RIG in believed) == (way == "image")  # of lost cameras half are not told
    assert not task.model.sketch.depth.training
    assert all(torch.equal(value, weights[name]) for name, value in task.model.sketch.state_dict().items())
    assert all(parameter.grad is None for parameter in task.model.sketch.parameters())


def test_other_batches_keep_their_images_rigs_and_stored_candidates(make_task, silent, monkeypatch):
    losses = []
    for words in (("augment=disturbed", *always("none")), ()):
        task = silent(make_task("model=extended", *words, "augment.erase_probability=0"))
        assert isinstance(task.augment.disturbances, Disturbances) == bool(words)
        monkeypatch.setattr(task.model, "propose", None)
        losses.append(task.training_step(make_batch(task, [(0, 2), (1, 2)]), 0))
    assert torch.equal(*losses)


def test_a_system_without_a_sketch_gets_the_disturbed_images(make_task, silent):
    task = silent(make_task("model=flashocc", "augment=disturbed", *always("camera")))
    task.set_training_statistics(torch.randint(1, 100, (12, *task.model.geometry.shape)))
    batch = make_batch(task, [(0, 2), (1, 2)], with_candidates=False)
    disturbed = task.training_step(batch, 0)
    task.augment.disturbances = None
    assert disturbed.isfinite()
    assert not torch.equal(disturbed, task.training_step(batch, 0))


def test_recorded_ranges_cannot_be_disturbed(make_task):
    with pytest.raises(UserError, match=r"augment=disturbed: the ranges of model/depth=truth"):
        make_task("model/depth=truth", "augment=disturbed")


@pytest.mark.parametrize("way", WAYS)
def test_the_depth_network_learns_true_panoramas_from_disturbed_batches(
    way, smoke, spec, make_task, silent, monkeypatch
):
    parts = Parts(smoke("augment=disturbed", "+appearance=disturbed", *always(way)))
    model = parts.depth()
    optimizer = parts.recipe("depth").optimizer
    assert isinstance(optimizer, AdamW)
    task = DepthTask(model, optimizer, model.rig_spheres(RIG), spec.range_edges_m, 0, {}, parts.appearance())
    given, losses = [], model.weighted_losses
    monkeypatch.setattr(model, "weighted_losses", lambda *inputs: given.append(inputs) or losses(*inputs))
    panorama = torch.rand(2, 12, 48) * 20 + 1
    batch = make_batch(make_task("model=flashocc"), [(0, 0), (1, 0)])._replace(erp_range_m=panorama)
    assert silent(task).training_step(batch, 0).isfinite()
    images, rigs, erp_range_m, *_ = given[0]
    assert torch.equal(erp_range_m, panorama)
    assert way == "camera" or (RIG in rigs) == (way == "image")  # of lost cameras half are not told
    assert (images.shape[-2:] == (36, 64)) == (way != "scale")
    assert images.is_floating_point()
    assert 0 <= float(images.min()) < float(images.max()) <= 1
