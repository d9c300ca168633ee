"""Random draws of a training step depend only on its place in the run."""

from types import SimpleNamespace

import torch

from omniocc.train.stage_task import step_generator


def draw(seed=0, step=0, batch=0, rank=0):
    task = SimpleNamespace(global_step=step, global_rank=rank)
    return torch.rand(3, generator=step_generator(task, seed, batch)).tolist()


def test_a_resumed_run_has_the_draws_of_an_uninterrupted_one():
    undisturbed = [draw(step=step) for step in range(4)]
    torch.rand(17)  # another state of the global generator
    assert [draw(step=step) for step in (2, 3)] == undisturbed[2:]


def test_every_coordinate_counts():
    places = [{}, {"seed": 1}, {"step": 1}, {"batch": 1}, {"rank": 1}]
    assert len({tuple(draw(**place)) for place in places}) == len(places)
