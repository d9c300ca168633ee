"""Where a network puts the road: read-outs and tables with known values."""

import math

import pytest
import road_height
import torch

from omniocc.model.depth import Spheres

SPHERES = Spheres(32, 1.0)


def test_read_outs_of_a_known_distribution():
    logits = torch.full((1, 32, 1, 1), -40.0)
    logits[0, [4, 5, 20], 0, 0] = torch.tensor([0.5, 0.3, 0.2]).log()
    found = {name: float(index) for name, index in road_height.read_outs(logits, SPHERES, 2).items()}
    assert found["as it is"] == pytest.approx((4 * 0.5 + 5 * 0.3) / 0.8, abs=1e-4)
    assert found["peak"] == pytest.approx(4)
    assert found["mean inverse range"] == pytest.approx(4 * 0.5 + 5 * 0.3 + 20 * 0.2, abs=1e-4)
    assert found["median"] == pytest.approx(4.5, abs=1e-3)
    ranges_m = [31 / 4, 31 / 5, 31 / 20]
    log_m = sum(p * math.log(range_m) for p, range_m in zip((0.5, 0.3, 0.2), ranges_m, strict=True))
    assert found["mean log range"] == pytest.approx(31 / math.exp(log_m), abs=1e-3)


def made_frame():
    """Return four rays for which a flat road is 10 m away: two hit it, one something at 5 m, one the sky."""
    true_m = torch.tensor([10.0, 10.0, 5.0, torch.inf])
    predicted_m = {"as it is": torch.tensor([9.0, 9.0, 6.0, 20.0]), "told": torch.tensor([8.0, 8.0, 6.0, 20.0])}
    road = torch.tensor([True, True, False, False])
    return road_height.Frame(true_m, torch.full((4,), 10.0), road, torch.full((4,), 10.0), SPHERES, predicted_m)


def test_the_tables_of_known_rays():
    row = road_height.reasons([made_frame()]).splitlines()[4]
    cells = [cell.strip() for cell in row.strip("|").split("|")]
    follows = f"{math.log(8 / 9) / math.log(0.8):.3f}"
    assert cells == ["8.5-12", "4", "0.50", "0.25", "0.25", "3.2", "0.900", "1.200", "0.900", follows]
    row = road_height.errors([made_frame()]).splitlines()[2]
    cells = [cell.strip() for cell in row.strip("|").split("|")]
    assert cells == ["as it is", "1.00", "1.00", "1.00", "nan", "nan", "-", "-", "0.900", "-", "-"]


def test_rigs_stand_where_the_table_says():
    rigs = [road_height.three_fisheyes(seed) for seed in road_height.SEEDS]
    assert len(set(rigs)) == 4
    assert all(len(rig.cameras) == 3 and rig.road_z_m == -1.2 for rig in rigs)
