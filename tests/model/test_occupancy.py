import io
import pickle

import pytest
import torch

from omniocc.camera.pinholes import as_pinholes
from omniocc.errors import UserError
from omniocc.extras.rivals import BiGrid, ChannelToHeight, CoarseToFine, Experts, Focus, SplatColoring
from omniocc.geometry import Cuboid, Cylinder
from omniocc.model import OccupancyModel, labels_of, probabilities_of
from omniocc.model.backbone import Backbone, EfficientNetLite0
from omniocc.model.hints import SketchAndPixels
from omniocc.model.lifter import (
    CoarseColoring,
    Coloring,
    Lifter,
    LiftSplat,
    Pillar,
)
from omniocc.model.occupancy import Classifier, smoothed_fractions
from omniocc.model.refiner import Attention, Conv, NoRefiner, Refiner, UNet
from omniocc.model.semantic_head import FCN, NoSemanticHead, SemanticHead
from omniocc.model.sketch import Dense, Random, Sketch
from omniocc.model.temporal import Mean, NoTemporal, Recurrent, Temporal

GRID = Cylinder((4, 6, 2))
CLASSES = 4


def every_frame(rigs, frames=1):
    """One rig per sample and frame."""
    return tuple((rig,) * frames for rig in rigs)


def loss_of(prediction):
    return prediction.logits.square().mean() + prediction.pixel_logits.square().mean()


def test_shapes_on_both_grids(geometry, make_model, images, poses, fisheye):
    prediction = make_model(geometry)(images, every_frame((fisheye, fisheye)), poses)
    assert prediction.logits.shape == (2, 12, *geometry.shape)
    assert prediction.pixel_logits.shape == (2, 6, 12, 9, 16)
    assert torch.isfinite(prediction.logits).all()


def test_every_option_keeps_its_slots_contract(make_backbone, make_model, geometry):
    model = make_model(geometry)
    options = {
        Backbone: [make_backbone(), EfficientNetLite0(None, True, 8, [4])],
        Sketch: [Dense(geometry), Random(geometry)],
        Lifter: [
            model.lifter,
            CoarseColoring(geometry, 8, [4], 1, 2, 2, 8, block=2),
            LiftSplat(geometry, 8, 8, [4], 4, (0.5, 20.5)),
            Pillar(geometry, 8, 8, [4], 1, 2, 2, 2, 8),
            BiGrid(geometry, Cylinder((8, 12, 4)), 8, 8, [4]),
            CoarseToFine(geometry, 8, 8, [4], 4, (0.5, 20.5), [1, 1], 2, [2, 2], 8, 0.1, [0.5], 12),
            SplatColoring(geometry, 8, 8, [4], 4, (0.5, 20.5), [2, 2, 1], 1, 2, 2, 8),
        ],
        Temporal: [NoTemporal(), Mean(geometry, 4, False), Recurrent(geometry, 8, 8, 1, 2, 2, 8, 4, False)],
        Refiner: [
            NoRefiner(8),
            UNet(geometry, 8, [8, 8]),
            Conv(geometry, 8, [8, 8], [1, 1]),
            ChannelToHeight(geometry, 8, 8, [8, 8], [1, 1]),
            Attention(geometry, 8, 1, 2, 2, 8, halved=True),
            Focus(geometry, 8, [8, 8], [1, 1]),
            Experts(geometry, 8, [8, 8], 2, 12),
        ],
        SemanticHead: [FCN(8, 8, 12), NoSemanticHead()],
    }
    for slot, modules in options.items():
        arguments = list(slot.__call__.__annotations__)
        for module in modules:
            assert isinstance(module, slot), (slot, module)
            assert list(type(module).forward.__annotations__) == arguments, (slot, module)


def test_gradients_reach_every_parameter_with_a_subset_of_candidates(make_model, geometry, images, poses, fisheye):
    model = make_model(geometry, Random(geometry, fraction=0.5, seed=1))
    loss_of(model(images, every_frame((fisheye, fisheye)), poses)).backward()
    for name, parameter in model.named_parameters():
        assert parameter.grad is not None, name
        assert torch.isfinite(parameter.grad).all(), name
        assert parameter.grad.abs().sum() > 0, name


@torch.no_grad()
def test_the_lifter_alone_may_take_cameras_for_pinholes(make_model, images, poses, fisheye, pinhole):
    model = make_model(Cylinder((8, 12, 4)), Random(Cylinder((8, 12, 4)), 0.5)).eval()
    own = model(images, every_frame((fisheye, pinhole)), poses)
    flat = model(images, every_frame((as_pinholes(fisheye), pinhole)), poses)
    model.lifter.lens = "pinhole"
    pretended = model(images, every_frame((fisheye, pinhole)), poses)
    torch.testing.assert_close(pretended.logits, flat.logits)
    assert torch.equal(pretended.pixel_logits, own.pixel_logits)
    assert not torch.allclose(pretended.logits[0], own.logits[0])
    torch.testing.assert_close(pretended.logits[1], own.logits[1])  # true pinholes stay what they are


def test_batch_of_two_rigs_equals_two_batches_of_one(make_model, images, poses, fisheye, pinhole):
    geometry = Cylinder((8, 12, 4))
    model = make_model(geometry, Random(geometry, 0.5)).double().eval()
    images = images.double() / 255
    both = model(images, every_frame((fisheye, pinhole)), poses)
    for index, rig in enumerate((fisheye, pinhole)):
        single = model(images[index : index + 1], ((rig,),), poses[index : index + 1])
        torch.testing.assert_close(both.logits[index], single.logits[0])
        torch.testing.assert_close(both.pixel_logits[index], single.pixel_logits[0])


def test_bytes_and_unit_floats_are_the_same_image(make_model, geometry, images, poses, fisheye):
    model = make_model(geometry).eval()
    rigs = every_frame((fisheye, fisheye))
    torch.testing.assert_close(model(images, rigs, poses).logits, model(images.float() / 255, rigs, poses).logits)


def test_only_the_frames_of_the_temporal_slot_are_used(make_model, geometry, images, poses, fisheye):
    model = make_model(geometry).eval()
    longer = torch.cat([torch.zeros_like(images), images], dim=1)
    rigs = every_frame((fisheye, fisheye))
    expected = model(images, rigs, poses).logits
    torch.testing.assert_close(
        model(longer, every_frame((fisheye, fisheye), 2), poses.expand(-1, 2, -1, -1)).logits, expected
    )


class Oldest(torch.nn.Module):
    frames = 2
    history_gradient = False

    def forward(self, volumes, world_from_ego, exists):
        assert len(volumes) == world_from_ego.shape[1] == 2
        assert not volumes[0].requires_grad
        return volumes[0] + 0 * volumes[1]


def test_past_frames_are_lifted_without_gradient_oldest_first(make_model, geometry, images, poses, fisheye):
    model = make_model(geometry).eval()
    rigs = every_frame((fisheye, fisheye))
    expected = model(images, rigs, poses).logits
    model.temporal = Oldest()
    window = torch.cat([images, torch.zeros_like(images)], dim=1)
    torch.testing.assert_close(
        model(window, every_frame((fisheye, fisheye), 2), poses.expand(-1, 2, -1, -1)).logits, expected
    )


def moving(frames):
    poses = torch.eye(4, dtype=torch.float64).repeat(2, frames, 1, 1)
    poses[:, :, 0, 3] = torch.arange(frames) * 2.5
    return poses


def test_missing_frames_give_the_result_of_a_shorter_window(make_model, geometry, images, fisheye):
    model = make_model(geometry, Random(geometry, 0.5)).double().eval()
    window = torch.rand(2, 3, *images.shape[2:], dtype=torch.float64)
    rigs, poses = every_frame((fisheye, fisheye), 3), moving(3)
    model.temporal = Mean(geometry, 3, False)
    exists = torch.tensor([[False, False, True], [False, True, True]])
    logits = model(window, rigs, poses, None, exists).logits
    model.temporal = Mean(geometry, 2, False)
    second = model(window[1:], rigs[1:], poses[1:]).logits
    torch.testing.assert_close(logits[1:], second)
    model.temporal = NoTemporal()
    torch.testing.assert_close(logits[:1], model(window[:1], rigs[:1], poses[:1]).logits)


@pytest.mark.parametrize("history_gradient", [False, True])
def test_history_has_a_gradient_only_with_history_gradient(make_model, geometry, images, fisheye, history_gradient):
    model = make_model(geometry)
    model.temporal = Mean(geometry, 2, history_gradient)
    window = torch.rand(2, 2, *images.shape[2:], requires_grad=True)
    loss_of(model(window, every_frame((fisheye, fisheye), 2), moving(2))).backward()
    past, newest = window.grad.abs().sum((0, 2, 3, 4, 5))
    assert newest > 0
    assert (past > 0) == history_gradient


def test_history_without_gradient_keeps_gradients_under_autocast(make_model, geometry, images, fisheye):
    model = make_model(geometry, Random(geometry, 0.5))
    model.temporal = Mean(geometry, 2, False)
    window = torch.cat([images, images.flip(0)], dim=1)
    with torch.autocast("cpu", torch.bfloat16):
        prediction = model(window, every_frame((fisheye, fisheye), 2), moving(2))
    loss_of(prediction).backward()
    assert [name for name, parameter in model.named_parameters() if parameter.grad is None] == []


def test_pickle_and_state_dict_round_trip(make_model, images, poses, fisheye):
    geometry = Cylinder((8, 12, 4))
    model = make_model(geometry, Random(geometry, 0.3, seed=5)).eval()
    rigs = every_frame((fisheye, fisheye))
    expected = model(images, rigs, poses).logits
    copy = pickle.loads(pickle.dumps(model))
    assert torch.equal(copy(images, rigs, poses).logits, expected)
    buffer = io.BytesIO()
    torch.save(model.state_dict(), buffer)
    buffer.seek(0)
    torch.manual_seed(9)
    other = make_model(geometry, Random(geometry, 0.3, seed=6)).eval()
    assert not torch.equal(other(images, rigs, poses).logits, expected)
    other.load_state_dict(torch.load(buffer, weights_only=True), strict=True)
    assert torch.equal(other(images, rigs, poses).logits, expected)


@pytest.mark.parametrize("refiner", ["none", "unet"])
def test_no_semantic_head_predicts_no_pixels(make_backbone, geometry, images, poses, fisheye, refiner):
    model = OccupancyModel(
        make_backbone(),
        geometry,
        Dense(geometry),
        Coloring(geometry, 8, [4], layers=1, heads=2, points=1, feedforward_channels=8),
        NoTemporal(),
        NoRefiner(8) if refiner == "none" else UNet(geometry, 8, [8, 8]),
        NoSemanticHead(),
        SketchAndPixels(geometry, 4, 8, 3),
        num_classes=3,
    )
    prediction = model(images, every_frame((fisheye, fisheye)), poses)
    assert prediction.pixel_logits is None
    assert prediction.logits.shape == (2, 3, *geometry.shape)


@pytest.mark.parametrize("slot", ["lifter", "temporal", "refiner"])
def test_a_part_that_returns_another_shape_is_named(slot, make_model, geometry, images, poses, fisheye, monkeypatch):
    model = make_model(geometry)
    part = getattr(model, slot)
    right = part.forward
    monkeypatch.setattr(part, "forward", lambda *given: right(*given)[..., :-1])
    shape = ", ".join(map(str, geometry.shape))
    with pytest.raises(
        UserError, match=rf"model\.{slot}\.\S+ returned features of shape .* needs .samples, 8, {shape}"
    ):
        model(images, every_frame((fisheye, fisheye)), poses)


def make(geometry=GRID, zeros=True):
    classifier = Classifier(geometry, 3, CLASSES)
    classifier.set_class_counts(torch.randint(0, 30, (CLASSES, *geometry.shape)))
    if zeros:
        torch.nn.init.zeros_(classifier.linear.weight)
    return classifier


def hints(batch=2):
    """Log-odds of being occupied, and scores of the occupied classes."""
    return torch.randn(batch, *GRID.shape), torch.randn(batch, *GRID.shape, CLASSES - 1)


def volume(batch=2, geometry=GRID):
    return torch.randn(batch, 3, *geometry.shape)


def test_shares_are_counts_drawn_towards_ring_height_and_grid():
    counts = torch.randint(0, 9, (3, *GRID.shape))
    shares = smoothed_fractions(counts, [1])
    assert torch.allclose(shares.sum(0), torch.ones(GRID.shape))
    equal = 1 / 3
    for r, theta, z in [(0, 0, 0), (3, 5, 1), (2, 1, 0)]:
        for label in range(3):
            share = equal
            for part in (counts, counts[..., z], counts[:, r, :, z], counts[:, r, theta, z]):
                part = part.reshape(3, -1).sum(1).tolist()
                share = (part[label] + 20 * share) / (sum(part) + 20)
            assert float(shares[label, r, theta, z]) == pytest.approx(share, rel=1e-5)


def test_without_rings_the_surroundings_of_a_voxel_are_its_height():
    counts = torch.randint(0, 9, (3, 4, 4, 2))
    shares = smoothed_fractions(counts, [])
    for x, y, z in [(0, 0, 0), (3, 2, 1)]:
        for label in range(3):
            share = 1 / 3
            for part in (counts, counts[..., z], counts[:, x, y, z]):
                part = part.reshape(3, -1).sum(1).tolist()
                share = (part[label] + 20 * share) / (sum(part) + 20)
            assert float(shares[label, x, y, z]) == pytest.approx(share, rel=1e-5)


@pytest.mark.parametrize("geometry", [GRID, Cuboid((4, 4, 2))])
def test_the_first_logits_are_the_frequencies_of_the_training_frames(geometry):
    counts = torch.zeros(CLASSES, *geometry.shape, dtype=torch.int64)
    counts[0], counts[2], counts[3] = 60_000, 30_000, 10_000
    classifier = make(geometry=geometry)
    classifier.set_class_counts(counts)
    probabilities = classifier(volume(geometry=geometry)).softmax(1)
    expected = torch.tensor([0.6, 0.0, 0.3, 0.1])[None, :, None, None, None].expand_as(probabilities)
    torch.testing.assert_close(probabilities, expected, atol=1e-3, rtol=0)


def test_log_odds_decide_free_or_occupied_and_the_frequencies_the_class():
    classifier, (log_odds, _) = make(), hints()
    probabilities = classifier(volume(), log_odds).softmax(1)
    torch.testing.assert_close(1 - probabilities[:, 0], log_odds.sigmoid())
    shares = probabilities[:, 1:] / probabilities[:, 1:].sum(1, keepdim=True)
    torch.testing.assert_close(shares[0], classifier.prior_shares.exp().movedim(-1, 0))


def test_class_scores_multiply_the_frequencies():
    classifier, (log_odds, scores) = make(), hints()
    probabilities = classifier(volume(), log_odds, scores).softmax(1)[:, 1:]
    shares = probabilities / probabilities.sum(1, keepdim=True)
    products = classifier.prior_shares.exp().movedim(-1, 0) * scores.softmax(-1).movedim(-1, 1)
    torch.testing.assert_close(shares, products / products.sum(1, keepdim=True))


def test_equal_scores_keep_the_frequencies():
    classifier, scores = make(), torch.full((2, *GRID.shape, CLASSES - 1), -1.5)
    given, without = classifier(volume(), None, scores), classifier(volume())
    torch.testing.assert_close(given, without.expand(2, -1, -1, -1, -1))


def test_the_linear_map_is_added_and_everything_learns():
    classifier, known, features = make(zeros=False), hints(), volume()
    logits = classifier(features, *known)
    expected = classifier.linear(features) + classifier.start(*known).movedim(-1, 1)
    torch.testing.assert_close(logits, expected)
    logits.square().mean().backward()
    assert all(parameter.grad.abs().sum() > 0 for parameter in classifier.parameters())


def test_without_counts_free_is_as_likely_as_all_others_together():
    probabilities = Classifier(GRID, 3, CLASSES).start().exp().detach()
    expected = torch.tensor([0.5, *[0.5 / (CLASSES - 1)] * (CLASSES - 1)])
    torch.testing.assert_close(probabilities[0, 0, 0, 0], expected)


def test_labels_and_probabilities_of_a_cell():
    # three cells, each with the probabilities of free and of two classes
    probability = torch.tensor([[0.5, 0.1, 0.4], [0.6, 0.3, 0.1], [0.2, 0.7, 0.1]])
    logits = probability.T.log()[:, :, None, None] + 7  # a constant changes no probability
    labels, found = labels_of(logits, None), probabilities_of(logits)
    assert labels.flatten().tolist() == [0, 0, 1]
    assert found[0].flatten().tolist() == pytest.approx([0.5, 0.4, 0.8], abs=1e-3)
    assert found[1].flatten().tolist() == pytest.approx([0.8, 0.75, 0.875], abs=1e-3)
    assert labels_of(logits, 0.45).flatten().tolist() == [2, 0, 1]
    assert labels_of(logits, 0.3).flatten().tolist() == [2, 1, 1]
    both = torch.stack([logits, logits.flip(1)])
    assert torch.equal(labels_of(both, 0.3)[1], labels_of(logits.flip(1), 0.3))
    assert probabilities_of(both).shape == (2, 2, 3, 1, 1)
