import pytest
import torch

from omniocc.geometry import Cylinder
from omniocc.model import Stream
from omniocc.model.hints import SketchAndPixels
from omniocc.model.ops.evidence import network_inputs
from omniocc.model.ops.voxel_samples import sample_at_voxels
from omniocc.model.protocols import Sketched, part_of
from omniocc.model.semantic_head import NoSemanticHead
from omniocc.model.temporal import Mean

GRID = Cylinder((8, 12, 4))
STRIDE, CHANNELS, CLASSES = 4, 8, 12


def make(queries=False, volume=False, logits=False, pixel_classes=False):
    return SketchAndPixels(GRID, STRIDE, CHANNELS, CLASSES, queries, volume, logits, pixel_classes)


@pytest.fixture
def sketched():
    bits = torch.randint(0, 256, (2, *GRID.shape), dtype=torch.uint8)
    return Sketched(torch.rand(2, *GRID.shape) < 0.5, bits)


@pytest.fixture
def pixel_logits():
    return torch.randn(2, 6, CLASSES, 9, 16)


def test_each_switch_reaches_its_place_alone(sketched, pixel_logits, fisheye):
    volume = torch.randn(2, CHANNELS, *GRID.shape)
    for switches in ({}, {"volume": True}, {"logits": True}, {"pixel_classes": True}, {"queries": True}):
        hints = make(**switches)
        known = hints(sketched, (fisheye, fisheye), pixel_logits)
        log_odds, scores = hints.in_logits(known)
        changed = not torch.equal(hints.in_volume(volume, known), volume)
        assert changed == ("volume" in switches or "pixel_classes" in switches)
        assert (log_odds is not None) == ("logits" in switches)
        assert (scores is not None) == ("pixel_classes" in switches)


def test_evidence_and_classes_are_mapped_and_added_to_the_volume(sketched, pixel_logits, fisheye):
    hints, volume = make(volume=True, pixel_classes=True), torch.randn(2, CHANNELS, *GRID.shape)
    known = hints(sketched, (fisheye, fisheye), pixel_logits)
    expected = volume + hints.evidence(network_inputs(sketched.evidence()))
    torch.testing.assert_close(hints.in_volume(volume, known), expected + hints.classes(known.classes.softmax(1)))


def test_logits_start_from_the_sketch_and_the_classes_of_the_pixels(sketched, pixel_logits, fisheye):
    hints, rigs = make(logits=True, pixel_classes=True), (fisheye, fisheye)
    log_odds, scores = hints.in_logits(hints(sketched, rigs, pixel_logits))
    assert torch.equal(log_odds, sketched.evidence()[:, 0])
    seen = sample_at_voxels(pixel_logits, sketched.candidates, rigs, GRID, STRIDE)
    torch.testing.assert_close(scores, seen[:, 1:].log_softmax(1).movedim(1, -1))
    nowhere = scores[~sketched.candidates]
    torch.testing.assert_close(nowhere, nowhere[:1, :1].expand_as(nowhere))  # which prefers no class
    (log_odds.sum() + (scores * torch.randn_like(scores)).sum()).backward()
    assert hints.class_weight.grad.abs().sum() > 0


def test_what_is_missing_is_named(sketched, fisheye):
    with pytest.raises(ValueError, match="its sketch has none: choose model/sketch=omni"):
        make(volume=True)(Sketched(sketched.candidates), (fisheye, fisheye), None)
    with pytest.raises(ValueError, match="needs a 2D head: choose model/semantic_head=fcn"):
        make(pixel_classes=True)(sketched, (fisheye, fisheye), None)


def test_live_frames_equal_windows(make_model, fisheye):
    model = make_model(GRID).eval()
    model.hints, model.temporal = make(volume=True, logits=True, pixel_classes=True), Mean(GRID, 2, False)
    images = torch.rand(1, 2, 6, 3, 36, 64)
    poses = torch.eye(4, dtype=torch.float64).repeat(1, 2, 1, 1)
    bits = torch.randint(0, 256, (1, 2, *GRID.shape), dtype=torch.uint8)
    sketched = Sketched(torch.rand(1, 2, *GRID.shape) < 0.5, bits)
    with torch.no_grad():
        expected = model(images, ((fisheye, fisheye),), poses, sketched).logits[0]
    stream = Stream(model)
    for frame in range(2):
        found = stream.step(images[0, frame], fisheye, poses[0, frame], part_of(sketched, slice(None), frame))
    torch.testing.assert_close(found, expected)
    model.semantic_head = NoSemanticHead()
    with pytest.raises(ValueError, match="needs a 2D head"):
        stream.step(images[0, 0], fisheye, poses[0, 0], part_of(sketched, slice(None), 0))
