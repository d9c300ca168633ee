import math

import pytest
import torch

from omniocc.loss import SILog

INF, NAN = float("inf"), float("nan")


@pytest.mark.parametrize("focus", [0.0, 0.85, 1.0])
def test_against_a_loop(focus):
    log_range = torch.tensor([[0.5, 1.0, 2.0], [1.5, 9.0, 9.0]])
    true_m = torch.tensor([[2.0, 3.0, 5.0], [8.0, INF, NAN]])
    gaps = [0.5 - math.log(2), 1 - math.log(3), 2 - math.log(5), 1.5 - math.log(8)]
    mean, squares = sum(gaps) / 4, sum(gap**2 for gap in gaps) / 4
    assert SILog(focus)(log_range, true_m).item() == pytest.approx(math.sqrt(squares - focus * mean**2), abs=1e-3)


def test_common_factor_is_removed():
    true_m = torch.rand(50) * 20 + 1
    assert SILog(1.0)(true_m.log() + 1, true_m) < 1e-3
    assert SILog(0.0)(true_m.log() + 1, true_m).item() == pytest.approx(1, abs=2e-3)


@pytest.mark.parametrize("true_m", [[INF, NAN, INF], [2.0, 2.0, NAN], [0.0, INF, 1.0]])
def test_finite_with_finite_gradients(true_m):
    log_range = torch.full((3,), math.log(2), requires_grad=True)
    loss = SILog(1.0)(log_range, torch.tensor(true_m))
    loss.backward()
    assert loss.isfinite()
    assert log_range.grad.isfinite().all()
    assert not log_range.grad[~torch.tensor(true_m).isfinite()].any()


def test_focus_out_of_range():
    with pytest.raises(ValueError, match=r"focus is 1\.5"):
        SILog(1.5)
