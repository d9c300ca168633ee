"""Gaps between rows, and their standard errors over seeds."""

import itertools
import math
import statistics

import numpy as np
import pytest
from scipy import stats

from omniocc.report.runs import FinishedRun
from omniocc.report.tables.gaps import UNKNOWN, Gap, Gaps, change, gap_of_systems, holm, paired_gap

KEY = "test/rayiou"


def row(name: str, *values: float) -> list[FinishedRun]:
    return [FinishedRun(f"{name}-{k:08x}", {"seed": k}, {KEY: value}) for k, value in enumerate(values)]


def test_two_rows_are_compared_as_in_a_paired_t_test():
    better, other = [0.30, 0.35, 0.31], [0.22, 0.28, 0.21]
    gap = Gaps({"ours": row("ours", *better), "dense": row("dense", *other)}, KEY).between("ours", "dense")
    reference = stats.ttest_rel(better, other)
    assert gap.here == pytest.approx(statistics.mean(better) - statistics.mean(other))
    assert gap.here / gap.error == pytest.approx(reference.statistic)
    assert gap.freedom == reference.df


def test_paired_differences_are_those_of_the_seeds_that_both_have():
    better, other = [0.30, 0.35, 0.31, 0.90], [0.22, 0.28, 0.21]
    gap = paired_gap(row("ours", *better), row("dense", *other), KEY)
    reference = stats.ttest_rel(better[:3], other)
    assert gap.here / gap.error == pytest.approx(reference.statistic)
    assert gap.p_none == pytest.approx(reference.pvalue)
    assert gap.freedom == 2
    single = paired_gap(row("ours", *better), row("dense", 0.25), KEY)
    assert single.here == pytest.approx(0.05)
    assert math.isnan(single.error)
    elsewhere = [run._replace(facts=run.facts | {"data": "d"}) for run in row("dense", *other)]
    assert paired_gap(row("ours", *better), elsewhere, KEY) is UNKNOWN


def test_all_rows_tell_about_the_noise():
    """Complete rows and seeds: the deviations from row mean and seed mean, as of a two-way analysis of variance."""
    values = {"a": [0.30, 0.36], "b": [0.20, 0.21], "c": [0.25, 0.29]}
    gaps = Gaps({name: row(name, *of_row) for name, of_row in values.items()}, KEY)
    means = {name: statistics.mean(of_row) for name, of_row in values.items()}
    seeds = [statistics.mean(of_row[k] for of_row in values.values()) for k in (0, 1)]
    every = statistics.mean(seeds)
    left = [of_row[k] - means[name] - seeds[k] + every for name, of_row in values.items() for k in (0, 1)]
    std = math.sqrt(sum(value * value for value in left) / 2)
    assert gaps.std == pytest.approx(std)
    assert gaps.between("a", "b") == pytest.approx((means["a"] - means["b"], std, 2))


def test_a_row_that_lacks_a_seed_is_compared_on_those_it_has():
    """Every figure of the second seed is .04 higher; the row without it owes nothing to that."""
    runs = {"ours": row("ours", 0.30, 0.34), "mono": row("mono", 0.20, 0.24), "dense": row("dense", 0.25)}
    assert Gaps(runs, KEY).between("ours", "dense") == pytest.approx((0.05, 0.0, 1))


def test_nothing_is_said_of_rows_that_no_seed_connects():
    other = [run._replace(facts={"seed": 7}) for run in row("dense", 0.25)]
    gaps = Gaps({"ours": row("ours", 0.30, 0.34), "dense": other}, KEY)
    assert all(map(math.isnan, gaps.between("ours", "dense")[:2]))
    assert gaps.between("ours", "mono") is UNKNOWN
    assert not Gaps({}, KEY).has("ours")


def test_a_seed_on_other_data_is_another_seed():
    """The two rows of other data are .1 lower; their gap is measured, one across the data is not."""
    elsewhere = {
        name: [run._replace(facts=run.facts | {"data": "d"}) for run in row(name, *values)]
        for name, values in {"far": (0.20, 0.25), "farther": (0.17, 0.22)}.items()
    }
    gaps = Gaps({"a": row("a", 0.30, 0.36), "b": row("b", 0.28, 0.34), **elsewhere}, KEY)
    assert gaps.between("far", "farther").here == pytest.approx(0.03)
    assert gaps.freedom == 2
    assert gaps.between("a", "far") is UNKNOWN


def test_a_seed_with_another_depth_network_is_another_seed():
    """Depth was trained again for the second seed of b, and for all of c; the last digits may differ by measurement."""

    def with_depth(name: str, values: list[float], errors_m: list[float]) -> list[FinishedRun]:
        runs = row(name, *values)
        return [
            run._replace(metrics=run.metrics | {"test/depth/mae": error_m})
            for run, error_m in zip(runs, errors_m, strict=True)
        ]

    rows = {
        "a": with_depth("a", [0.30, 0.36, 0.32], [1.51054263, 1.51045752, 1.52]),
        "b": with_depth("b", [0.28, 0.50, 0.31], [1.51054265, 1.5140866, 1.52]),
        "c": with_depth("c", [0.20, 0.22], [1.51761591, 1.52752591]),
    }
    shared = paired_gap(rows["a"], rows["b"], KEY)
    assert shared[:2] == pytest.approx((0.015, 0.005))
    gaps = Gaps(rows, KEY)
    assert gaps.between("a", "b") == pytest.approx(shared)
    assert gaps.between("a", "c") is UNKNOWN
    assert paired_gap(rows["a"], rows["c"], KEY) is UNKNOWN


def test_systems_are_compared_as_in_welchs_t_test():
    better, other = [0.30, 0.35, 0.31], [0.22, 0.28]
    reference = stats.ttest_ind(better, other, equal_var=False)
    gap = gap_of_systems(row("ours", *better), row("bevdet", *other), KEY)
    assert gap.here / gap.error == pytest.approx(reference.statistic)
    assert gap.freedom == pytest.approx(reference.df)
    assert gap_of_systems(row("ours", 0.3, 0.3, 0.3), row("bevdet", 0.2, 0.2), KEY) == pytest.approx((0.1, 0.0, 3))
    for ours in ([0.3], [0.29, 0.3, 0.31]):  # three seeds of one system say nothing of the other's standard deviation
        single = gap_of_systems(row("ours", *ours), row("bevdet", 0.2), KEY)
        assert single.here == pytest.approx(0.1)
        assert math.isnan(single.error)
    assert gap_of_systems(row("ours", 0.3), [], KEY) is UNKNOWN


def test_a_change_has_the_noise_of_both_gaps():
    """Two gaps that rest on two samples each: Welch's t for the contrast of the four means."""
    samples = [0.30, 0.35, 0.31], [0.22, 0.28, 0.21, 0.20], [0.5, 0.51], [0.30, 0.32, 0.35]
    first, last = (
        gap_of_systems(row("a", *better), row("b", *other), KEY) for better, other in (samples[:2], samples[2:])
    )
    moved = change(first, last)
    means = [statistics.mean(sample) for sample in samples]
    squares = [statistics.variance(sample) / len(sample) for sample in samples]
    freedom = sum(squares) ** 2 / sum(
        square * square / (len(sample) - 1) for square, sample in zip(squares, samples, strict=True)
    )
    assert moved == pytest.approx((means[2] - means[3] - means[0] + means[1], math.sqrt(sum(squares)), freedom))
    assert change(Gap(0.1, 0.0, 4), Gap(0.3, 0.0, 2)) == pytest.approx((0.2, 0.0, 6))
    assert math.isnan(change(first, UNKNOWN).here)


def test_seeds_without_a_figure_are_left_out():
    """Means .32 and .25; variances .0007 of three seeds and .0018 of two."""
    ours, other = row("a", 0.3, 0.35, math.nan, 0.31), row("b", 0.22, math.nan, 0.28)
    assert gap_of_systems(ours, other, KEY)[:2] == pytest.approx((0.07, math.sqrt(0.0007 / 3 + 0.0018 / 2)))
    ours, other = row("a", 0.30, 0.36, math.nan), row("b", 0.20, 0.24, 0.5)
    assert Gaps({"a": ours, "b": other}, KEY).between("a", "b") == pytest.approx((0.11, 0.01, 1))


def test_as_r_adjusts():
    """`p.adjust(c(0.01, 0.02, 0.03, 0.04), "holm")` and `p.adjust(c(.03, .001, .9, .001, .2), "holm")` of R."""
    assert holm([0.01, 0.02, 0.03, 0.04]) == pytest.approx([0.04, 0.06, 0.06, 0.06])
    assert holm([0.03, 0.001, 0.9, 0.001, 0.2]) == pytest.approx([0.09, 0.005, 0.9, 0.005, 0.4])
    assert holm([]) == []
    assert holm([0.6, 0.7]) == [1.0, 1.0]
    assert holm([0.01, np.nan, 0.02]) == pytest.approx([0.02, np.nan, 0.02], nan_ok=True)
    assert holm([0.01, np.nan], tests=4) == pytest.approx([0.04, np.nan], nan_ok=True)


def test_it_is_the_closed_test_of_bonferronis():
    """A hypothesis is rejected if every set of hypotheses that has it is rejected by Bonferroni's smallest p-value."""
    for p_values in np.random.default_rng(0).uniform(0, 0.4, (20, 5)):
        sets = [chosen for size in range(1, 6) for chosen in itertools.combinations(range(5), size)]
        closed = [
            max(min(1.0, len(chosen) * min(p_values[j] for j in chosen)) for chosen in sets if k in chosen)
            for k in range(5)
        ]
        assert holm(list(p_values)) == pytest.approx(closed)
