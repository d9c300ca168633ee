import pytest
import torch

from omniocc.metric import CalibrationError
from omniocc.model.ops.depth.confidence import Confidence, confidence_features, fit_logistic


def drawn(weights, count=40_000):
    """Return probabilities, ranges and rights whose odds follow `weights`."""
    generator = torch.Generator().manual_seed(3)
    probability = torch.rand(count, generator=generator) * 0.98 + 0.01
    range_m = torch.rand(count, generator=generator) * 30 + 1
    p = (confidence_features(probability, range_m) @ torch.tensor(weights)).sigmoid()
    return probability, range_m, torch.rand(count, generator=generator) < p


def test_the_regression_finds_the_weights_that_made_the_data():
    probability, range_m, right = drawn((0.6, -0.8, 1.5))
    found = fit_logistic(confidence_features(probability, range_m), right)
    assert found.tolist() == pytest.approx([0.6, -0.8, 1.5], abs=0.1)
    # at the greatest likelihood its gradient is zero
    x = confidence_features(probability, range_m).double()
    assert (x.T @ ((x @ found).sigmoid() - right.double()) / len(x)).abs().max() < 1e-5


def test_before_the_fit_it_is_the_probability_and_after_it_calibrated():
    probability, range_m, right = drawn((0.6, -0.8, 1.5))
    confidence = Confidence()
    torch.testing.assert_close(confidence(probability, range_m), probability)
    errors = []
    for _ in range(3):
        said = confidence(probability, range_m)
        metric = CalibrationError()
        metric.update(said, right)
        errors.append(metric.compute()["ece"].item())
        confidence.fit(said, range_m, right)
    assert errors[0] > 0.1
    assert errors[1] < 0.01
    # fitted again to its own confidence it stays as it is
    assert errors[2] == pytest.approx(errors[1], abs=1e-3)
    assert confidence.weights.tolist() == pytest.approx([0.6, -0.8, 1.5], abs=0.1)


def test_what_is_always_right_gives_finite_weights():
    probability, range_m, _ = drawn((1.0, 0.0, 0.0), 100)
    found = fit_logistic(confidence_features(probability, range_m), torch.ones(100, dtype=torch.bool))
    assert bool(found.isfinite().all())


def test_weights_from_before_the_calibration_can_be_loaded():
    confidence = Confidence()
    confidence.weights.mul_(2)
    confidence.load_state_dict({})
    assert confidence.weights.tolist() == [2.0, 0.0, 0.0]


def test_it_is_in_single_precision_under_autocast():
    confidence, probability = Confidence(), torch.tensor([0.9, 0.99, 0.999])
    with torch.autocast("cpu", dtype=torch.bfloat16):
        found = confidence(probability, torch.ones(3))
    torch.testing.assert_close(found, probability)
