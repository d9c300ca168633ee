"""The paper's gaps beside ours."""

import math
import statistics
from pathlib import Path

import pytest
from scipy import stats

from omniocc.report.claims import STUDENT, Claim, claim_cells, claims_of, pooled_spread
from omniocc.report.paper_table import load_table
from omniocc.report.runs import FinishedRun

SKETCH = load_table(Path(__file__).parents[2] / "sweeps" / "sketch.yaml")


def row(name: str, *values: float) -> list[FinishedRun]:
    return [FinishedRun(f"{name}-{k:08x}", {"seed": k}, {"test/rayiou": value}) for k, value in enumerate(values)]


def test_the_spread_of_all_rows_is_that_of_their_deviations():
    rows = [row("a", 0.30, 0.34), row("b", 0.1, 0.2, 0.3), row("c", 0.9)]
    deviations = [-0.02, 0.02, -0.1, 0.0, 0.1]
    assert pooled_spread(rows, "test/rayiou") == (pytest.approx(math.sqrt(sum(d * d for d in deviations) / 3)), 3)
    assert math.isnan(pooled_spread([row("a", 0.3), row("c", 0.9)], "test/rayiou")[0])


def test_gaps_stand_beside_the_papers_with_their_standard_error():
    runs = {"ours": row("ours", 0.30, 0.34), "dense": row("dense", 0.20), "mono": row("mono", 0.33, 0.33)}
    claims = {claim.title: claim for claim in claims_of(SKETCH, runs, "test/rayiou")}
    assert set(claims) == {"dense voxels", "mono depth"}
    spread = math.sqrt(statistics.variance([0.30, 0.34]) / 2)
    assert claims["dense voxels"].paper == pytest.approx(0.470 - 0.434)
    assert claims["dense voxels"].here == pytest.approx(0.12)
    assert claims["dense voxels"].error == pytest.approx(spread * math.sqrt(1 / 2 + 1))
    assert claims["dense voxels"].verdict == "holds (4.9)"
    assert claims["mono depth"].verdict == "cannot be told apart (0.5)"


def test_verdicts():
    assert Claim("a", 0.1, -0.3, 0.1, 4).verdict == "opposite (3.0)"
    assert Claim("a", 0.1, -0.3, 0.1, 2).verdict == "cannot be told apart (3.0)"
    assert Claim("a", 0.1, 0.3, math.nan, 0).verdict == "same sign (spread unknown)"
    assert Claim("a", 0.1, -0.3, math.nan, 0).verdict == "not the same sign (spread unknown)"
    assert Claim("a", 0.1, 0.3, 0.0, 40).verdict == "holds (inf)"


def test_what_is_clear_follows_students_t():
    assert pytest.approx(stats.t.ppf(0.975, range(1, len(STUDENT) + 1)), abs=0.006) == list(STUDENT)


def test_the_same_claims_are_made_against_lidar_rays():
    def with_lidar(runs):
        return [
            run._replace(metrics=run.metrics | {"test/lidar/rayiou": 1 - run.metrics["test/rayiou"]}) for run in runs
        ]

    runs = {"ours": with_lidar(row("ours", 0.30, 0.34)), "dense": with_lidar(row("dense", 0.20))}
    head, rows = claim_cells(SKETCH, runs)
    assert head[-2:] == ["LiDAR", "claim"]
    assert rows == [
        [
            "dense voxels",
            "+0.036",
            "+0.120 ± 0.035",
            "cannot be told apart (3.5)",
            "-0.120 ± 0.035",
            "cannot be told apart (3.5)",
        ],
    ]
    assert claim_cells(SKETCH, {"ours": row("ours", 0.3), "dense": row("dense", 0.2)})[1] == [
        ["dense voxels", "+0.036", "+0.100", "same sign (spread unknown)"],
    ]
