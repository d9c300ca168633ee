import math

import pytest
import torch
from torchmetrics.classification import BinaryCalibrationError

from omniocc.metric import CalibrationError


def test_by_hand():
    metric = CalibrationError(bins=2)
    metric.update(torch.tensor([0.2, 0.4]), torch.tensor([True, False]))
    metric.update(torch.tensor([[0.9, 0.7]]), torch.tensor([[True, True]]))
    scores = {key: value.item() for key, value in metric.compute().items()}
    assert scores == pytest.approx({"ece": 0.5 * 0.2 + 0.5 * 0.2, "confidence": 0.55, "right": 0.75})
    assert metric.reliability().tolist() == [pytest.approx([0.5, 0.3, 0.5]), pytest.approx([0.5, 0.8, 1.0])]


def test_as_torchmetrics_computes_it():
    generator = torch.Generator().manual_seed(0)
    confidence = torch.rand(5000, generator=generator)
    right = torch.rand(5000, generator=generator) < confidence**2
    metric, theirs = CalibrationError(), BinaryCalibrationError(n_bins=15, norm="l1")
    for part in (slice(0, 700), slice(700, 5000)):
        metric.update(confidence[part], right[part])
        theirs.update(confidence[part], right[part].int())
    assert metric.compute()["ece"].item() == pytest.approx(theirs.compute().item(), abs=1e-6)


def test_ends_belong_to_the_outer_bins_and_nothing_gives_nan():
    metric = CalibrationError(bins=4)
    metric.update(torch.empty(0), torch.empty(0, dtype=torch.bool))
    assert math.isnan(metric.compute()["ece"].item())
    metric.update(torch.tensor([0.0, 1.0, 0.25]), torch.tensor([False, True, False]))
    assert metric.reliability()[:, 0].tolist() == pytest.approx([2 / 3, 0, 0, 1 / 3])
    assert metric.reliability()[1].isnan().tolist() == [False, True, True]


def test_wrong_input_is_named():
    metric = CalibrationError()
    with pytest.raises(ValueError, match="bins must be at least 1, got 0"):
        CalibrationError(bins=0)
    with pytest.raises(ValueError, match=r"preds must be confidences in \[0, 1\]"):
        metric.update(torch.tensor([math.nan]), torch.tensor([True]))
    with pytest.raises(ValueError, match="target must be bool of shape"):
        metric.update(torch.tensor([0.5]), torch.tensor([1]))


def test_the_diagram_shows_every_filled_bin():
    metric = CalibrationError(bins=5)
    metric.update(torch.tensor([0.1, 0.5, 0.5]), torch.tensor([False, True, False]))
    _, axes = metric.plot()
    dots = axes.collections[0]
    assert dots.get_offsets()[[0, 2]].tolist() == [pytest.approx([0.1, 0.0]), pytest.approx([0.5, 0.5])]
    assert dots.get_sizes()[2] > dots.get_sizes()[0]
    assert axes.texts[0].get_text() == f"ECE {0.1 / 3:.3f}"
