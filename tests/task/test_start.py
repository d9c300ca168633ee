"""What a training starts from: another run with its optimiser, or weights alone."""

from dataclasses import replace

import pytest
import torch
from torch import nn

from omniocc.config import plain
from omniocc.errors import UserError
from omniocc.run.checkpoint_io import write_checkpoint
from omniocc.task import AdamW
from omniocc.task.stage_task import Recipe
from omniocc.task.start import check_resumed, check_weights, load_first_weights, load_fitting


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
        load_first_weights(model, recipe, "depth", checkpoint)
        assert torch.equal(model.weight, given.weight) == kept


@pytest.mark.parametrize(
    ("overrides", "steps", "message"),
    [
        ((), 6, None),
        ((), None, None),
        (("augment.flip_probability=0.25", "trainer.max_steps=7"), 7, None),
        ((), 5, "5 steps are done and the training ends after 5; give a larger trainer.max_steps"),
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
        (("rate_factors={backbone: 0.5}",), 6, r"rate_factors={'backbone': 0.5} \(there None\)"),
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
    line = load_fitting(same.model, path)
    tensors = [name for name in same.model.state_dict() if not name.startswith("sketch.")]
    assert line == f"{len(tensors)} of {len(tensors)} tensors from {path}"
    assert all((parameter == 0.125).all() for parameter in same.model.parameters())
    other = make_task("model/sketch=dense", "model/refiner=attention").model
    known = {name: value.shape for name, value in trained.model.state_dict().items()}
    before = {name: value.clone() for name, value in other.named_parameters()}
    new = [name for name, value in before.items() if known.get(name) != value.shape]
    assert f"; new are {new[0]}" in load_fitting(other, path)
    assert {name.split(".")[0] for name in new} == {"refiner"}
    for name, value in other.named_parameters():
        assert value.equal(before[name] if name in new else torch.full_like(value, 0.125)), name


def test_weights_of_which_none_fits_are_an_error(make_task, saved):
    task = make_task("model/sketch=dense")
    path = saved(task, state_dict={"model.other.weight": torch.ones(2)})
    with pytest.raises(UserError, match="none of its weights has the name and shape"):
        load_fitting(task.model, str(path))
