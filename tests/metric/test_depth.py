import math

import pytest
import torch

from omniocc.metric import DepthMetrics, sphere_index


def test_by_hand():
    metric = DepthMetrics(nearest_m=1.0, farthest_m=math.inf, spheres=11)  # index = 10 / range
    metric.update(torch.tensor([2.0, 4.0, 5.0]), torch.tensor([2.5, 4.0, math.inf]))
    metric.update(torch.tensor([[10.0]]), torch.tensor([[5.0]]))
    scores = {key: value.item() for key, value in metric.compute().items()}
    assert scores["mae"] == pytest.approx((0.5 + 0 + 5) / 3)
    assert scores["rmse"] == pytest.approx(math.sqrt((0.25 + 25) / 3))
    assert scores["absrel"] == pytest.approx((0.2 + 0 + 1) / 3)
    # ratios 1.25 (not below 1.25), 1 and 2
    assert [scores[f"delta{k}"] for k in (1, 2, 3)] == pytest.approx([1 / 3, 2 / 3, 2 / 3])
    # indices 5, 2.5, 1 against 4, 2.5, 2: off by 1, 0, 1 of 11 spheres
    assert scores["index_mae"] == pytest.approx(2 / 3 * 100 / 11)
    assert scores["index_rmse"] == pytest.approx(math.sqrt(2 / 3) * 100 / 11)
    assert [scores[f"index>{k}"] for k in (1, 3, 5)] == pytest.approx([2 / 3] * 3)


def test_indices_run_from_the_farthest_to_the_nearest_sphere():
    ranges = torch.tensor([50.0, 1.0])
    assert sphere_index(ranges, 1.0, 50.0, 192).tolist() == pytest.approx([0, 191])
    assert sphere_index(torch.tensor(math.inf), 0.5, math.inf, 192).item() == 0


def test_bands_add_up_and_ranges_outside_the_spheres_do_not_count():
    generator = torch.Generator().manual_seed(0)
    true = torch.rand(1000, generator=generator) * 40
    ours = true * (1 + 0.2 * torch.randn(1000, generator=generator)).clamp(min=0.3)
    metric = DepthMetrics(nearest_m=1.0, farthest_m=30.0, range_edges_m=(0.0, 8.5, 17.0))
    observed = torch.rand(1000, generator=generator) < 0.8
    for i in range(0, 1000, 250):
        part = slice(i, i + 250)
        metric.update(ours[part], true[part], observed[part])
    scores = metric.compute()
    for name, low, high in (("mae", 1.0, 30.0), ("mae_0-8.5m", 1.0, 8.5), ("mae_8.5-17m", 8.5, 17.0)):
        counted = observed & (true >= low) & (true < high)
        assert scores[name].item() == pytest.approx((ours.clamp(1, 30) - true)[counted].abs().mean().item(), rel=1e-5)
    assert len(scores) == 3 * 11


def test_no_rays_are_nan():
    metric = DepthMetrics(range_edges_m=(0, 5))
    metric.update(torch.ones(3), torch.full((3,), math.inf))
    assert all(math.isnan(value) for value in metric.compute().values())


@pytest.mark.parametrize(
    ("prediction_m", "target_m", "message"),
    [
        (torch.ones(2), torch.ones(3), r"shape.*\(2,\).*\(3,\)"),
        (torch.tensor([0.0]), torch.ones(1), "above 0.* 0.0"),
        (torch.tensor([math.nan]), torch.ones(1), "above 0.* nan"),
        (torch.tensor([math.inf]), torch.ones(1), "inf.*farthest_m"),
    ],
)
def test_error_names_wrong_input(prediction_m, target_m, message):
    with pytest.raises(ValueError, match=message):
        DepthMetrics().update(prediction_m, target_m)


def test_error_names_wrong_arguments():
    with pytest.raises(ValueError, match=r"nearest_m.*farthest_m.*\(3\.0, 2\.0\)"):
        DepthMetrics(nearest_m=3.0, farthest_m=2.0)
    with pytest.raises(ValueError, match=r"spheres.* 0\.5.* 1"):
        DepthMetrics(spheres=1)
