"""What a training starts from: another run with its optimiser, or weights alone."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch
from torch import nn

from omniocc.camera import Rig
from omniocc.config import build, plain
from omniocc.errors import UserError
from omniocc.runs.checkpoint_io import write_checkpoint
from omniocc.train import AdamW
from omniocc.train.stage_task import Recipe
from omniocc.train.start import check_resumed, check_weights, load_first_weights, load_fitting, start_from

DEPTH = str(Path(__file__).parents[2] / "tools" / "weights" / "any-rig-depth.safetensors")
"""A depth network for any rig, without pretrained features."""


@pytest.fixture
def saved(tmp_path):
    """Write a checkpoint of a task, of the occupancy stage at step 5 unless it is said otherwise."""

    def save(task, **other):
        content = {"config": task.config, "state_dict": task.state_dict(), "stage": "occupancy", "global_step": 5}
        write_checkpoint({**content, **other}, tmp_path / "given.ckpt")
        return tmp_path / "given.ckpt"

    return save


def test_given_weights_stay_when_a_stage_without_training_is_entered_again(tmp_path):
    """As for candidates of another threshold: the stage has a checkpoint, and no figures for this selection."""
    given, last = nn.Linear(1, 1), tmp_path / "last.ckpt"
    weights = {f"model.{name}": value for name, value in given.state_dict().items()}
    torch.save({"config": {"seed": 1}, "state_dict": weights, "stage": "depth"}, last)
    fixed = Recipe(0, None, 1, 1, 0, AdamW(0.1, 1, 0.0, 0.0), weights=str(last))
    for recipe, checkpoint, kept in (
        (fixed, None, True),
        (fixed, last, True),
        (replace(fixed, weights=None), None, False),
        (replace(fixed, max_steps=5), last, False),  # the trainer loads it
        (replace(fixed, max_steps=5), None, True),
    ):
        model = nn.Linear(1, 1)
        load_first_weights(model, recipe, "depth", checkpoint, {"seed": 1})
        assert torch.equal(model.weight, given.weight) == kept


@pytest.mark.parametrize(
    ("overrides", "steps", "message"),
    [
        ((), 6, None),
        ((), None, None),
        (("augment.flip_probability=0.25", "stages.occupancy.max_steps=7"), 7, None),
        ((), 5, "5 steps are done and the training ends after 5; give a larger stages.occupancy.max_steps"),
        (
            ("optimizer.learning_rate=0.5",),
            6,
            r"optimizer.learning_rate=0.5 \(there 0.003\). .* weights=.*given.ckpt takes",
        ),
        (
            ("model/refiner=none",),
            6,
            r"model.refiner._target_=omniocc.model.refiner.NoRefiner .there omniocc.model.refiner.UNet",
        ),
        (("lr_multipliers={backbone: 0.5}",), 6, r"lr_multipliers={'backbone': 0.5} \(there None\)"),
        (("ema_decay=0.9",), 6, r"ema_decay=0.9 \(there None\)"),
    ],
)
def test_a_training_goes_on_only_with_the_same_network_and_optimiser(
    overrides, steps, message, make_task, smoke, saved
):
    path = saved(make_task("model/sketch=dense"))
    config = plain(smoke("model/sketch=dense", *overrides))
    if message is None:
        check_resumed(path, config, steps)
        return
    with pytest.raises(UserError, match=message):
        check_resumed(path, config, steps)


def test_a_checkpoint_of_another_stage_or_without_optimiser_is_refused(make_task, saved):
    task = make_task("model/sketch=dense")
    with pytest.raises(UserError, match=r"resume=\S+given.ckpt is a checkpoint of the depth stage"):
        check_resumed(saved(task, stage="depth"), task.config, 6)
    with pytest.raises(UserError, match="it holds weights alone"):
        check_resumed(saved(task, global_step=None), task.config, 6)


def test_given_weights_are_checked_before_anything_is_trained(make_task, saved, tmp_path):
    with pytest.raises(FileNotFoundError, match=r"gone\.ckpt"):
        check_weights(str(tmp_path / "gone.ckpt"), "auto")
    path = saved(make_task("model/sketch=dense"), stage="sketch")
    with pytest.raises(UserError, match=r"of the sketch stage.*stages\.sketch\.weights"):
        check_weights(str(path), "auto")
    with pytest.raises(UserError, match="leave it out, or leave out weights=tiny"):
        check_weights("tiny", str(path))
    check_weights("tiny", "never")


def test_weights_that_fit_are_taken_and_the_others_are_named(make_task, saved):
    trained = make_task("model/sketch=dense")
    for parameter in trained.parameters():
        nn.init.constant_(parameter, 0.125)
    path = str(saved(trained))
    same = make_task("model/sketch=dense")
    line = load_fitting(same.model, path, same.config)
    counted = "sketch.", "classifier.prior_log_odds", "classifier.prior_shares"
    tensors = [name for name in same.model.state_dict() if not name.startswith(counted)]
    assert line == f"{len(tensors)} of {len(tensors)} tensors from {path}"
    assert all((parameter == 0.125).all() for parameter in same.model.parameters())
    other = make_task("model/sketch=dense", "model/refiner=attention")
    known = {name: value.shape for name, value in trained.model.state_dict().items()}
    before = {name: value.clone() for name, value in other.model.named_parameters()}
    new = [name for name, value in before.items() if known.get(name) != value.shape]
    assert f"; new are {new[0]}" in load_fitting(other.model, path, other.config)
    assert {name.split(".")[0] for name in new} == {"refiner"}
    for name, value in other.model.named_parameters():
        assert value.equal(before[name] if name in new else torch.full_like(value, 0.125)), name


def test_weights_of_which_none_fits_are_an_error(make_task, saved):
    task = make_task("model/sketch=dense")
    path = saved(task, state_dict={"model.other.weight": torch.ones(2)})
    with pytest.raises(UserError, match="none of its weights has the name and shape"):
        load_fitting(task.model, str(path), task.config)


def test_the_frequencies_of_the_classes_are_those_of_the_own_data(make_task, saved):
    trained, task = make_task("model/sketch=dense"), make_task("model/sketch=dense")
    trained.set_training_statistics(torch.full((12, *trained.model.geometry.shape), 3))
    task.set_training_statistics(torch.arange(12).view(12, 1, 1, 1).expand(12, *task.model.geometry.shape))
    before = {name: value.clone() for name, value in task.model.classifier.named_buffers()}
    assert set(before) == set(task.model.classifier.COUNTED)
    load_fitting(task.model, str(saved(trained)), task.config)
    for name, value in task.model.classifier.named_buffers():
        assert value.equal(before[name]), name
        assert not value.equal(getattr(trained.model.classifier, name)), name


def test_it_is_said_that_the_weights_are_of_another_grid(make_task, saved):
    trained, far = make_task("model/sketch=dense"), make_task("model/sketch=dense", "model.geometry.radius_m=[0,50]")
    line = load_fitting(far.model, str(saved(trained)), far.config)
    assert line.endswith("another grid: model.geometry.radius_m=[0, 50] (there [0.0, 25.6])")


def test_weights_of_a_depth_network_that_fit_another_one_are_told(smoke):
    def given(*overrides):
        cfg = smoke("preset=tiny", *overrides)
        return build(cfg.depth), plain(cfg)

    for overrides, told in (
        (("depth.hints=true", "depth.pairs=nearest"), None),
        (("depth.hints=true",), "trained with other values: depth.pairs=alternate (there nearest)"),
    ):
        model, config = given(*overrides)
        line = start_from(model, DEPTH, "depth", config)
        assert line == (told and f"stages.depth.weights={DEPTH} fit; they were {told}")
    model, config = given()
    with pytest.raises(UserError, match=r"size mismatch.*that it has there: .*depth\.hints=False \(there True\)"):
        start_from(model, DEPTH, "depth", config)


def test_features_added_to_a_trained_network_change_nothing_at_first(smoke):
    own, more = (
        ("preset=tiny", "depth.hints=true", "depth.pairs=nearest"),
        ("depth.pretrained=true", "depth.weights=null"),
    )
    without, with_features = (smoke(*own, *others) for others in ((), more))
    first, second = build(without.depth), build(with_features.depth)
    for model, cfg in ((first, without), (second, with_features)):
        start_from(model, DEPTH, "depth", plain(cfg))
    rig = Rig.load("fisheye6").resized(64, 36)
    images = torch.rand(1, len(rig.cameras), 3, 36, 64, generator=torch.Generator().manual_seed(0))
    ranges_m = [model.eval()(images, (rig,)).range_m for model in (first, second)]
    assert torch.equal(*ranges_m)
    assert second.features.added[0][1].weight.requires_grad


def test_nothing_that_a_checkpoint_names_is_imported_to_compare_networks(smoke, tmp_path):
    cfg = smoke()
    model, config = build(cfg.model.sketch), plain(cfg)
    foreign = {**config, "model": {**config["model"], "sketch": {"_target_": "gone.Sketch", "threshold": 0.5}}}
    weights = {f"model.{name}": value for name, value in model.state_dict().items()}
    write_checkpoint({"config": foreign, "state_dict": weights, "stage": "sketch"}, tmp_path / "theirs.ckpt")
    line = start_from(model, str(tmp_path / "theirs.ckpt"), "sketch", config)
    assert line.endswith("model.sketch._target_=omniocc.model.sketch.Omni (there gone.Sketch)")
