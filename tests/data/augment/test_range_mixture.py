import pytest
import torch

from omniocc.data.augment.range_mixture import RangeMixture, smooth_field


def draw(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def test_true_ranges_replace_predicted_ones_where_they_are_known():
    predicted = torch.tensor([[[1.0, 2.0, torch.nan]]])
    true = torch.tensor([[[torch.nan, torch.inf, 4.0]]])

    found, changed = RangeMixture(1, 0, 0.1)(predicted, true, draw())

    assert changed.tolist() == [True]
    assert found.tolist() == [[[1.0, torch.inf, 4.0]]]


def test_errors_are_of_the_logarithm_and_keep_unknown_ranges():
    predicted = torch.full((64, 24, 48), 10.0)
    predicted[:, 0] = torch.nan

    found, changed = RangeMixture(0, 1, 0.1)(predicted, None, draw())

    assert bool(changed.all())
    assert bool(found[:, 0].isnan().all())
    errors = (found[:, 1:] / 10).log()
    assert float(errors.std()) == pytest.approx(0.1, rel=0.3)
    assert abs(float(errors.mean())) < 0.01


def test_each_sample_is_drawn_for_itself_and_by_the_generator():
    predicted, true = torch.ones(4000, 2, 4), torch.full((4000, 2, 4), 2.0)
    mixture = RangeMixture(0.3, 0.2, 0.1)

    found, changed = mixture(predicted, true, draw())
    again, _ = mixture(predicted, true, draw())

    assert torch.equal(found, again)
    true_ones = (found == 2).all((1, 2))
    assert float(true_ones.float().mean()) == pytest.approx(0.3, abs=0.03)
    assert float(changed.float().mean()) == pytest.approx(0.5, abs=0.03)
    assert bool((found[~changed] == 1).all())


def test_without_true_ranges_no_sample_is_true():
    found, changed = RangeMixture(1, 0, 0.1)(torch.ones(2, 2, 4), None, draw())

    assert not bool(changed.any())
    assert bool((found == 1).all())


def test_the_field_has_no_seam():
    field = smooth_field(torch.Size((200, 48, 192)), draw())

    steps = (field - field.roll(1, -1)).square().mean((0, 1)).sqrt()
    assert float(steps[0]) < 1.5 * float(steps.max())
    assert float(steps[0]) < 0.5


def test_more_than_all_samples_are_refused():
    with pytest.raises(ValueError, match=r"1\.2 together"):
        RangeMixture(0.7, 0.5, 0.1)
