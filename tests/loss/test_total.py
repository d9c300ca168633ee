from typing import NamedTuple

import pytest
import torch

from omniocc.extras.rivals import RunLengths
from omniocc.geometry import Cylinder
from omniocc.loss import CrossEntropy, Dice, RangeBins, Semantics, TotalLoss
from omniocc.loss.total import labels_of_blocks


class Prediction(NamedTuple):
    logits: torch.Tensor
    pixel_logits: torch.Tensor | None
    range_logits: torch.Tensor | None = None
    run_lengths: torch.Tensor | None = None
    coarse_logits: tuple = ()


def total(weights):
    return TotalLoss({"ce": CrossEntropy(2.0, 3), "dice": Dice()}, {"semantics": Semantics()}, weights)


def batch():
    torch.manual_seed(0)
    voxels = torch.randint(0, 3, (2, 4, 3, 2), dtype=torch.uint8)
    pixels = torch.randint(0, 3, (2, 6, 4, 8), dtype=torch.uint8)
    return Prediction(torch.randn(2, 3, 4, 3, 2), torch.randn(2, 6, 3, 2, 4)), voxels, pixels


def test_named_weighted_terms():
    loss = total({"ce": 1.0, "dice": 0.5, "semantics": 2.0})
    prediction, voxels, pixels = batch()
    terms = loss(prediction, voxels, pixels)
    assert list(terms) == ["ce", "dice", "semantics"]
    torch.testing.assert_close(terms["dice"], 0.5 * Dice()(prediction.logits, voxels))
    torch.testing.assert_close(terms["semantics"], 2 * Semantics()(prediction.pixel_logits, pixels))


def test_no_pixel_terms_without_a_semantic_head():
    prediction, voxels, pixels = batch()
    terms = total({"ce": 1.0, "dice": 1.0, "semantics": 1.0})(prediction._replace(pixel_logits=None), voxels, pixels)
    assert list(terms) == ["ce", "dice"]


def test_class_counts_reach_the_cross_entropy_and_the_state_dict():
    loss = total({"ce": 1.0, "dice": 1.0, "semantics": 1.0})
    loss.set_class_counts(torch.tensor([8, 1, 1]))
    assert loss.state_dict()["voxel.ce.weights"][0] < loss.state_dict()["voxel.ce.weights"][1]


def test_names_must_match():
    with pytest.raises(ValueError, match="same names"):
        total({"ce": 1.0, "dise": 1.0, "semantics": 1.0})


def test_terms_of_rays_need_a_lifter_that_estimates_ranges():
    prediction, voxels, pixels = batch()
    range_m, ranges = torch.rand(2, 6, 4, 8) * 10, torch.randn(2, 6, 5, 2, 4)
    loss = TotalLoss({"dice": Dice()}, {}, {"dice": 1.0, "ranges": 3.0}, {"ranges": RangeBins((1.0, 9.0))})
    terms = loss(prediction._replace(range_logits=ranges), voxels, pixels, range_m)
    torch.testing.assert_close(terms["ranges"], 3 * RangeBins((1.0, 9.0))(ranges, range_m))
    with pytest.raises(ValueError, match="model/lifter=lift_splat"):
        loss(prediction, voxels, pixels, range_m)


def test_terms_of_runs_need_a_refiner_that_predicts_them():
    prediction, voxels, pixels = batch()
    lengths, term = torch.rand(2, 6, 4, 3, 2), RunLengths(Cylinder((4, 3, 2)), 1.0, 2.0)
    loss = TotalLoss({"dice": Dice()}, {}, {"dice": 1.0, "runs": 3.0}, run={"runs": term})
    terms = loss(prediction._replace(run_lengths=lengths), voxels, pixels)
    torch.testing.assert_close(terms["runs"], 3 * term(lengths, voxels))
    assert set(loss(prediction, None, pixels)) == set()
    with pytest.raises(ValueError, match="model/refiner=focus"):
        loss(prediction, voxels, pixels)


def test_terms_of_coarser_grids_are_means_over_blocks_of_every_size():
    prediction, voxels, pixels = batch()
    coarse = ((4, torch.randn(2, 3, 1, 1, 1)), (2, torch.randn(2, 3, 2, 2, 1)))
    loss = TotalLoss({"dice": Dice()}, {}, {"dice": 1.0, "blocks": 3.0}, coarse={"blocks": CrossEntropy(2.0, 3)})
    loss.set_class_counts(torch.tensor([8, 1, 1]))
    terms = loss(prediction._replace(coarse_logits=coarse), voxels, pixels)
    parts = [loss.coarse["blocks"](logits, labels_of_blocks(voxels, block, 3)) for block, logits in coarse]
    torch.testing.assert_close(terms["blocks"], 1.5 * (parts[0] + parts[1]))
    assert loss.coarse["blocks"].weights[0] < loss.coarse["blocks"].weights[1]
    assert set(loss(prediction, None, pixels)) == set()
    with pytest.raises(ValueError, match="model=oneocc"):
        loss(prediction, voxels, pixels)


def test_blocks_at_the_ends_have_the_labels_of_their_voxels():
    voxels = torch.zeros(1, 5, 4, 3, dtype=torch.uint8)
    voxels[0, 4, 3, 2], voxels[0, 0, 0, 0], voxels[0, 0, 1, 0], voxels[0, 1, 1, 1] = 2, 1, 1, 2
    expected = torch.zeros(1, 3, 2, 2, dtype=torch.uint8)
    expected[0, 2, 1, 1], expected[0, 0, 0, 0] = 2, 1
    assert torch.equal(labels_of_blocks(voxels, 2, 3), expected)
    # the corner of an odd grid holds two voxels: one that is unknown is no more than half of them
    voxels[0, 4, 0, 2] = 255
    assert torch.equal(labels_of_blocks(voxels, 2, 3), expected)
    voxels[0, 4, 1, 2], expected[0, 2, 0, 1] = 255, 255
    assert torch.equal(labels_of_blocks(voxels, 2, 3), expected)


def test_absent_labels_give_no_terms():
    prediction, voxels, pixels = batch()
    loss = total({"ce": 1.0, "dice": 1.0, "semantics": 1.0})
    assert set(loss(prediction, None, pixels)) == {"semantics"}
    assert set(loss(prediction, voxels, None)) == {"ce", "dice"}
    assert loss(prediction, None, None) == {}
    rays = TotalLoss({"dice": Dice()}, {}, {"dice": 1.0, "ranges": 3.0}, {"ranges": RangeBins((1.0, 9.0))})
    assert set(rays(prediction, voxels, pixels)) == {"dice"}


def test_class_counts_reach_every_loss_that_weighs_classes():
    class Weighing(Dice):
        def set_class_counts(self, counts):
            self.counts = counts

    loss = TotalLoss({"mine": Weighing()}, {}, {"mine": 1.0})
    loss.set_class_counts(torch.tensor([8, 1, 1]))
    assert loss.voxel["mine"].counts.tolist() == [8, 1, 1]
