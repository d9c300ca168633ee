import math

import pytest
import torch

from omniocc.geometry import Cylinder
from omniocc.model import Stream
from omniocc.model.sketch import Random, Sketched
from omniocc.model.temporal import Mean, NoTemporal

GRID = Cylinder((8, 12, 4))
LENGTHS = {"a": 6, "b": 2, "c": 4}
FRAMES = 4


@pytest.fixture
def model(make_model):
    model = make_model(GRID, Random(GRID, 0.5)).double().eval()
    model.temporal = Mean(GRID, FRAMES, False)
    return model


@pytest.fixture
def recording():
    """Images, poses and candidates of every frame of three scenes, by scene and number."""
    frames = {}
    for scene, length in LENGTHS.items():
        for number in range(length):
            pose = torch.eye(4, dtype=torch.float64)
            yaw = 0.1 * number
            pose[:2, :2] = torch.tensor([[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]])
            pose[0, 3] = 40 + 1.7 * number
            images = torch.rand(6, 3, 36, 64, dtype=torch.float64)
            frames[scene, number] = images, pose, torch.rand(GRID.shape) < 0.4
    return frames


def window(recording, scene, newest):
    numbers = range(newest - FRAMES + 1, newest + 1)
    parts = zip(*(recording[scene, max(0, number)] for number in numbers), strict=True)
    return *(torch.stack(part) for part in parts), torch.tensor([number >= 0 for number in numbers])


def batch(recording, samples, rig):
    columns = zip(*(window(recording, *sample) for sample in samples), strict=True)
    images, poses, candidates, exists = (torch.stack(column) for column in columns)
    names = tuple(f"{scene}/{newest:06d}" for scene, newest in samples)
    return images, ((rig,) * FRAMES,) * len(samples), poses, Sketched(candidates), exists, names


ORDERS = {
    "in order": [[("a", 0), ("a", 1)], [("a", 2), ("a", 3)], [("a", 4), ("a", 5)], [("b", 0), ("b", 1)], [("c", 0)]],
    "every second, as one of two processes": [[("a", 0), ("a", 2)], [("a", 4), ("b", 0)], [("c", 0), ("c", 2)]],
    "out of order": [[("c", 3)], [("a", 5), ("c", 0)], [("a", 1)], [("a", 2), ("a", 0)]],
}


@pytest.mark.parametrize("order", list(ORDERS))
def test_the_same_numbers_as_without_memory(model, recording, fisheye, order):
    stream = Stream(model)
    for samples in ORDERS[order]:
        images, rigs, poses, sketched, exists, names = batch(recording, samples, fisheye)
        with torch.no_grad():
            expected = model(images, rigs, poses, sketched, exists).logits
        logits = stream.windows(images, rigs, poses, sketched, exists, names)
        torch.testing.assert_close(logits, expected, rtol=0, atol=1e-10)
        assert len(stream) <= FRAMES - 1


def test_in_order_every_frame_is_lifted_once(model, recording, fisheye, monkeypatch):
    lifted = []
    lift = model.lift
    monkeypatch.setattr(model, "lift", lambda images, *rest: lifted.append(len(images)) or lift(images, *rest))
    stream = Stream(model)
    for samples in ORDERS["in order"]:
        stream.windows(*batch(recording, samples, fisheye))
    assert lifted == [2, 2, 2, 2, 1]


def test_live_frames_equal_windows(model, recording, fisheye):
    stream, windows = Stream(model), Stream(model)
    for scene, length in LENGTHS.items():
        stream.reset()
        for number in range(length):
            images, pose, candidates = recording[scene, number]
            logits = stream.step(images, fisheye, pose, Sketched(candidates[None]))
            expected = windows.windows(*batch(recording, [(scene, number)], fisheye))[0]
            torch.testing.assert_close(logits, expected, rtol=0, atol=1e-10)
            assert len(stream) <= FRAMES - 1


def test_the_sketch_is_run_without_given_candidates(model, recording, fisheye):
    images, rigs, poses, _, exists, names = batch(recording, [("a", 3), ("b", 0)], fisheye)
    with torch.no_grad():
        expected = model(images, rigs, poses, None, exists).logits
    logits = Stream(model).windows(images, rigs, poses, None, exists, names)
    torch.testing.assert_close(logits, expected, rtol=0, atol=1e-10)


def test_reset_drops_volumes_of_other_weights(model, recording, fisheye):
    stream = Stream(model)
    stream.windows(*batch(recording, [("a", 2)], fisheye))
    with torch.no_grad():
        model.lifter.empty += 1
    images, rigs, poses, sketched, exists, names = batch(recording, [("a", 3)], fisheye)
    with torch.no_grad():
        expected = model(images, rigs, poses, sketched, exists).logits
    assert not torch.allclose(stream.windows(images, rigs, poses, sketched, exists, names), expected)
    stream.reset()
    assert len(stream) == 0
    logits = stream.windows(images, rigs, poses, sketched, exists, names)
    torch.testing.assert_close(logits, expected, rtol=0, atol=1e-10)


def test_without_a_past_nothing_is_remembered(model, recording, fisheye):
    model.temporal = NoTemporal()
    stream = Stream(model)
    images, rigs, poses, sketched, exists, names = batch(recording, [("a", 2), ("a", 3)], fisheye)
    with torch.no_grad():
        expected = model(images, rigs, poses, sketched, exists).logits
    logits = stream.windows(images, rigs, poses, sketched, exists, names)
    torch.testing.assert_close(logits, expected, rtol=0, atol=1e-10)
    assert len(stream) == 0
