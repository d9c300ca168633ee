"""The paper's gaps beside ours."""

import math
import statistics
from pathlib import Path

import pytest
from scipy import stats

from omniocc.report.runs import FinishedRun
from omniocc.report.tables.claims import Claim, Gaps, claim_cells, claims_of
from omniocc.report.tables.paper import load_table

SKETCH = load_table(Path(__file__).parents[3] / "sweeps" / "sketch.yaml")


def row(name: str, *values: float) -> list[FinishedRun]:
    return [FinishedRun(f"{name}-{k:08x}", {"seed": k}, {"test/rayiou": value}) for k, value in enumerate(values)]


def test_two_rows_are_compared_as_in_a_paired_t_test():
    better, other = [0.30, 0.35, 0.31], [0.22, 0.28, 0.21]
    gaps = Gaps({"ours": row("ours", *better), "dense": row("dense", *other)}, "test/rayiou")
    reference = stats.ttest_rel(better, other)
    gap, error = gaps.between("ours", "dense")
    assert gap == pytest.approx(statistics.mean(better) - statistics.mean(other))
    assert gap / error == pytest.approx(reference.statistic)
    assert gaps.freedom == reference.df


def test_all_rows_tell_about_the_spread():
    """Complete rows and seeds: the deviations from row mean and seed mean, as of a two-way analysis of variance."""
    values = {"a": [0.30, 0.36], "b": [0.20, 0.21], "c": [0.25, 0.29]}
    gaps = Gaps({name: row(name, *of_row) for name, of_row in values.items()}, "test/rayiou")
    means = {name: statistics.mean(of_row) for name, of_row in values.items()}
    seeds = [statistics.mean(of_row[k] for of_row in values.values()) for k in (0, 1)]
    every = statistics.mean(seeds)
    left = [of_row[k] - means[name] - seeds[k] + every for name, of_row in values.items() for k in (0, 1)]
    spread = math.sqrt(sum(value * value for value in left) / 2)
    assert gaps.freedom == 2
    assert gaps.between("a", "b") == pytest.approx((means["a"] - means["b"], spread))


def test_a_row_that_lacks_a_seed_is_compared_on_those_it_has():
    """Every figure of the second seed is .04 higher; the row without it owes nothing to that."""
    runs = {"ours": row("ours", 0.30, 0.34), "mono": row("mono", 0.20, 0.24), "dense": row("dense", 0.25)}
    gaps = Gaps(runs, "test/rayiou")
    assert gaps.between("ours", "dense") == pytest.approx((0.05, 0.0))
    assert gaps.freedom == 1
    assert [claim.title for claim in claims_of(SKETCH, runs, "test/rayiou")] == ["mono depth", "dense voxels"]


def test_nothing_is_said_of_rows_that_no_seed_connects():
    other = [run._replace(facts={"seed": 7}) for run in row("dense", 0.25)]
    gaps = Gaps({"ours": row("ours", 0.30, 0.34), "dense": other}, "test/rayiou")
    assert all(map(math.isnan, gaps.between("ours", "dense")))
    assert all(map(math.isnan, gaps.between("ours", "mono")))
    assert claims_of(SKETCH, {}, "test/rayiou") == []
    claim, *_ = claims_of(SKETCH, {"ours": row("ours", 0.30, 0.34), "dense": other}, "test/rayiou")
    assert (claim.title, claim.gap, claim.verdict) == ("dense voxels", "–", "no seed in common")


def test_gaps_stand_beside_the_papers_with_their_standard_error():
    runs = {"ours": row("ours", 0.30, 0.34), "dense": row("dense", 0.18, 0.26), "mono": row("mono", 0.33, 0.32)}
    claims = {claim.title: claim for claim in claims_of(SKETCH, runs, "test/rayiou")}
    assert set(claims) == {"dense voxels", "mono depth"}
    assert claims["dense voxels"].paper == pytest.approx(0.470 - 0.434)
    assert claims["dense voxels"].here == pytest.approx(0.10)
    assert claims["dense voxels"].verdict == "cannot be told apart (3.1)"
    assert claims["mono depth"].verdict == "cannot be told apart (0.2)"


def test_verdicts():
    assert Claim("a", 0.1, -0.3, 0.1, 4).verdict == "opposite (3.0)"
    assert Claim("a", 0.1, -0.3, 0.1, 2).verdict == "cannot be told apart (3.0)"
    assert Claim("a", 0.1, 0.3, math.nan, 0).verdict == "same sign (spread unknown)"
    assert Claim("a", 0.1, -0.3, math.nan, 0).verdict == "not the same sign (spread unknown)"
    assert Claim("a", 0.1, 0.3, 0.0, 40).verdict == "holds (inf)"


@pytest.mark.parametrize(("freedom", "errors"), [(1, 12.71), (2, 4.30), (4, 2.78), (10, 2.23), (30, 2.04)])
def test_a_gap_is_found_from_the_95_percent_point_of_students_t_on(freedom, errors):
    assert Claim("a", 0.1, errors - 0.02, 1.0, freedom).verdict.startswith("cannot be told apart")
    assert Claim("a", 0.1, errors + 0.02, 1.0, freedom).verdict.startswith("holds")


def test_the_same_claims_are_made_against_lidar_rays():
    def with_lidar(runs):
        return [
            run._replace(metrics=run.metrics | {"test/lidar/rayiou": 1 - run.metrics["test/rayiou"]}) for run in runs
        ]

    runs = {"ours": with_lidar(row("ours", 0.30, 0.34)), "dense": with_lidar(row("dense", 0.20, 0.20))}
    head, rows = claim_cells(SKETCH, runs)
    assert head[-2:] == ["LiDAR", "claim"]
    assert rows == [
        [
            "dense voxels",
            "+0.036",
            "+0.120 ± 0.020",
            "cannot be told apart (6.0)",
            "-0.120 ± 0.020",
            "cannot be told apart (6.0)",
        ],
    ]
    assert claim_cells(SKETCH, {"ours": row("ours", 0.3), "dense": row("dense", 0.2)})[1] == [
        ["dense voxels", "+0.036", "+0.100", "same sign (spread unknown)"],
    ]
