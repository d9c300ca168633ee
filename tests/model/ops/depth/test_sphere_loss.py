import math

import pytest
import torch

from omniocc.model.depth import Spheres
from omniocc.model.ops.depth.sphere_net import SphereLoss, two_hot_cross_entropy

SPHERES = Spheres(11, 1.0)  # index 10 at 1 m, 1 at 10 m
INF, NAN = float("inf"), float("nan")


def test_cross_entropy_is_least_where_the_mean_is_the_index():
    index = torch.tensor([[[3.3]]])

    def loss(fraction):
        probability = torch.full((1, 8, 1, 1), 1e-6)
        probability[0, 3], probability[0, 4] = 1 - fraction, fraction
        return two_hot_cross_entropy(probability.log(), index).item()

    assert loss(0.3) == pytest.approx(-(0.7 * math.log(0.7) + 0.3 * math.log(0.3)), abs=1e-4)
    assert loss(0.3) < min(loss(0.25), loss(0.35))


def test_terms_against_a_loop():
    torch.manual_seed(0)
    logits = torch.randn(1, 12, 2, 3)  # eleven spheres and the sky
    index = torch.tensor([[[5.0, 1.0, 0.2], [10.0, 3.0, 0.0]]])
    true_m = torch.tensor([[[2.5, 5.0, INF], [0.5, NAN, 4.0]]])
    terms = SphereLoss(log_range_weight=2.0, entropy_weight=0.5, sky_weight=0.3)(logits, index, true_m, SPHERES)
    index_losses, log_losses, entropies, sky_losses = [], [], [], []
    log_p = logits[:, :11].double().log_softmax(1)
    for row, column in ((0, 0), (0, 1), (0, 2), (1, 0), (1, 2)):  # all but nan
        true = min(10.0, 10 / true_m[0, row, column].item())
        is_sky = 1 / (1 + math.exp(-logits[0, 11, row, column].item()))
        sky_losses.append(-math.log(is_sky if true <= 0.5 else 1 - is_sky))
        if true <= 0.5:
            continue
        ours = index[0, row, column].item()
        gap = abs(ours - true)
        index_losses.append(0.5 * gap**2 if gap < 1 else gap - 0.5)
        lower = min(int(true), 9)
        fraction = true - lower
        near = log_p[0, :, row, column]
        entropies.append(-((1 - fraction) * near[lower] + fraction * near[lower + 1]).item())
        ratio = abs(math.log(max(ours, 0.5) / true))
        log_losses.append(0.5 * ratio**2 / 0.05 if ratio < 0.05 else ratio - 0.025)
    assert (len(sky_losses), len(log_losses)) == (5, 4)
    assert terms["index"].item() == pytest.approx(sum(index_losses) / 4, rel=1e-5)
    assert terms["log_range"].item() == pytest.approx(2 * sum(log_losses) / 4, rel=1e-5)
    assert terms["spheres"].item() == pytest.approx(0.5 * sum(entropies) / 4, rel=1e-5)
    assert terms["sky"].item() == pytest.approx(0.3 * sum(sky_losses) / 5, rel=1e-5)


def test_without_truth_there_is_nothing_to_learn():
    logits = torch.randn(1, 12, 2, 2, requires_grad=True)
    terms = SphereLoss(1.0, 1.0, 1.0)(logits, logits.mean(1), torch.full((1, 2, 2), NAN), SPHERES)
    sum(terms.values()).backward()
    assert [term.item() for term in terms.values()] == [0, 0, 0, 0]
    assert not logits.grad.any()
