"""The paper's gaps beside ours, and the rule by which a claim is decided."""

import math
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from omniocc.report.runs import FinishedRun
from omniocc.report.tables.claims import (
    Claim,
    Judged,
    Rows,
    claims_of,
    error_over_streets,
    metric_of,
    names_in,
    pairs_of,
    planned_claims,
    verdicts_of,
)
from omniocc.report.tables.gaps import Gap
from omniocc.report.tables.paper import PaperTable, load_table
from omniocc.report.tables.verdicts import HEAD, claim_lines
from omniocc.runs.scenes import LIDAR as LIDAR_RAYS
from omniocc.runs.scenes import RAYS, save_scenes
from omniocc.runs.table import SURFACE_RAYIOU, VOXEL_RAYIOU

SWEEPS = Path(__file__).parents[3] / "sweeps"
SKETCH, COMPARISON = (load_table(SWEEPS / f"{name}.yaml").of_steps("1000") for name in ("sketch", "comparison"))
OWN, LIDAR = "test/rayiou", "test/lidar/rayiou"


def row(name: str, *values: float, lidar: float | None = None) -> list[FinishedRun]:
    """Return runs of seeds 0, 1, ...; `lidar` times their score against LiDAR rays."""
    return [
        FinishedRun(f"{name}-{k:08x}", {"seed": k}, {OWN: value} | ({} if lidar is None else {LIDAR: lidar * value}))
        for k, value in enumerate(values)
    ]


def cells(table: PaperTable, rows: Rows, judge: str) -> list[list[str]]:
    """Return the lines of the table of all claims in one metric."""
    return [line.cells for line in claim_lines([table], rows, verdicts_of([table], rows)) if line.judge == judge]


def titles(table: PaperTable) -> list[tuple[str, str]]:
    return [(better.run, other.run) for better, other in pairs_of(table)]


def test_claimed_are_the_best_over_all_others_and_what_the_table_adds():
    assert titles(SKETCH) == [("ours", other) for other in ("wo_dilation", "mono", "dense", "random")]
    second = "voxformer_pinhole@1000"
    assert titles(COMPARISON) == [
        *(("ours", other) for other in ("bevdet", "bevformer", second)),
        (second, "bevdet"),
        (second, "bevformer"),
    ]
    assert titles(load_table(SWEEPS / "beyond.yaml")) == []


def test_the_papers_gap_is_taken_in_proportion_to_the_score_here():
    runs = {"ours": row("ours", 0.20, 0.27, lidar=0.5), "dense": row("dense", 0.18, 0.26, lidar=0.5)}
    for judge, score in ((VOXEL_RAYIOU, 0.235), (SURFACE_RAYIOU, 0.1175)):
        (claim,) = claims_of([SKETCH], runs, judge).values()
        assert claim.paper == pytest.approx(0.470 - 0.434)
        assert claim.size == pytest.approx((0.470 - 0.434) / 0.470 * score)
        assert claim.gap.here == pytest.approx(score - 0.22 * score / 0.235)


def test_parts_are_compared_by_seed_and_systems_are_not():
    """The tables have the same rows; the second seed is about .05 higher in both."""
    runs = {"ours": row("ours", 0.30, 0.35), "bevdet": row("bevdet", 0.20, 0.26)}
    parts = COMPARISON._replace(compares="parts")
    alone = parts._replace(rows=[entry._replace(alone=entry.run == "bevdet") for entry in parts.rows])
    scores = [0.30, 0.35], [0.20, 0.26]
    for table, reference in (
        (COMPARISON, stats.ttest_ind(*scores, equal_var=False)),
        (alone, stats.ttest_ind(*scores, equal_var=False)),
        (parts, stats.ttest_rel(*scores)),
    ):
        (claim,) = claims_of([table], runs, VOXEL_RAYIOU).values()
        assert claim.gap.p_none == pytest.approx(reference.pvalue)


def test_rows_that_stand_alone_tell_nothing_about_the_noise_of_the_others():
    runs = {"ours": row("ours", 0.30, 0.35), "wo_dilation": row("wo", 0.29, 0.35), "dense": row("dense", 0.1, 0.9)}
    (first, second) = claims_of([SKETCH], runs, VOXEL_RAYIOU).values()
    assert first.gap.p_none == pytest.approx(stats.ttest_rel([0.30, 0.35], [0.29, 0.35]).pvalue)
    assert second.gap.p_none == pytest.approx(stats.ttest_ind([0.30, 0.35], [0.1, 0.9], equal_var=False).pvalue)


@pytest.mark.parametrize("paired", [False, True])
def test_parts_with_other_networks_are_compared_as_systems(paired):
    """The row without dilation has the depth of both seeds trained again."""
    scores = [0.30, 0.35], [0.29, 0.35]
    again = [run._replace(metrics=run.metrics | {"test/depth/mae": 1.5}) for run in row("wo", *scores[1])]
    (claim,) = claims_of(
        [SKETCH], {"ours": row("ours", *scores[0]), "wo_dilation": again}, VOXEL_RAYIOU, paired
    ).values()
    assert claim.gap.p_none == pytest.approx(stats.ttest_ind(*scores, equal_var=False).pvalue)


def test_p_values_are_those_of_students_t():
    claim = Claim(0.1, 0.08, Gap(0.03, 0.02, 6))
    assert claim.gap.p_none == pytest.approx(2 * stats.t(6).sf(1.5))
    assert claim.p_size == pytest.approx(stats.t(6).cdf(-2.5))
    assert Claim(0.1, 0.08, Gap(0.03, 0.0, 6)).gap.p_none == 0.0
    assert Claim(0.1, 0.08, Gap(0.03, 0.0, 6)).p_size == 0.0
    assert Claim(0.1, 0.03, Gap(0.03, 0.0, 6)).p_size == 1.0
    assert Claim(0.1, 0.03, Gap(0.0, 0.0, 6)).gap.p_none == 1.0
    assert math.isnan(Claim(0.1, 0.03, Gap(0.1, math.nan, 0)).gap.p_none)


@pytest.mark.parametrize(
    ("here", "none", "size", "verdict"),
    [
        (0.03, 0.049, 0.001, "holds"),  # smaller than the paper's, and still there
        (0.03, 0.051, 0.049, "does not hold (smaller)"),
        (0.03, 0.051, 0.051, "undecided"),
        (-0.03, 0.049, 0.2, "does not hold (opposite sign)"),
        (-0.03, 0.051, 0.001, "does not hold (smaller)"),
        (-0.03, 0.2, 0.2, "undecided"),
    ],
)
def test_verdicts(here, none, size, verdict):
    assert Judged(Claim(0.1, 0.08, Gap(here, 0.02, 6)), none, size).verdict == verdict


def test_with_one_seed_nothing_is_decided():
    assert Judged(Claim(0.1, 0.08, Gap(0.3, math.nan, 0)), math.nan, math.nan).verdict == "undecided (one seed only)"
    assert Claim(0.1, 0.08, Gap(math.nan, math.nan, 0)).gap.written == "–"


def test_the_family_has_every_claim_of_all_tables_once():
    """`comparison` and a copy of it have the same five claims, `sketch` has four, of which some have not run."""
    runs = {
        "ours": row("ours", 0.30, 0.31, lidar=0.7),
        "voxformer_pinhole@1000": row("vox", 0.21, 0.23, lidar=0.7),
        "bevdet": row("bevdet", 0.20, 0.24, lidar=0.7),
        "dense": row("dense", 0.25, 0.24, lidar=0.7),
    }
    tables = [COMPARISON, COMPARISON._replace(name="again"), SKETCH]
    found = verdicts_of(tables, runs)
    own = [entry for (*_, key), entry in found.items() if key == OWN]
    assert len(own) == len(found) / 2 == 4  # over BEVDet, VoxFormer and dense voxels, and VoxFormer over BEVDet
    least = min(own, key=lambda entry: entry.claim.gap.p_none)
    assert least.none == pytest.approx(9 * least.claim.gap.p_none)
    assert min(own, key=lambda entry: entry.claim.p_size).size == pytest.approx(min(1, 9 * least_size(own)))


def least_size(found: list[Judged]) -> float:
    return min(entry.claim.p_size for entry in found)


def test_rows_without_printed_figures_have_claims_of_their_own(tmp_path):
    """Two seeds of difference .09 and .11: t = 10 of one degree of freedom, p = .0635 and in a family of two .127."""
    rows = "rows: {ours: {title: paper's}, mine: {title: mine}, plain: {title: plain}}"
    text = f"title: Mine\norder_by: {OWN}\ncolumns: {{{OWN}: RayIoU}}\n{rows}\nclaims: [[mine, plain], [mine, ours]]\n"
    (tmp_path / "mine.yaml").write_text(text)
    table = load_table(tmp_path / "mine.yaml")
    assert titles(table) == [("mine", "plain"), ("mine", "ours")]
    runs = {"mine": row("mine", 0.30, 0.34), "plain": row("plain", 0.21, 0.23)}
    (found,) = verdicts_of([table], runs).values()
    assert found.none == pytest.approx(0.12690, abs=1e-5)
    first, not_run = cells(table, runs, VOXEL_RAYIOU)
    told = ["mine ahead of plain", "Mine", "undecided", "+0.100 ± 0.010", "–", "–", "–", "2 and 2", "0.063 (0.13)", "–"]
    assert first == told
    assert not_run == ["mine ahead of paper's", "Mine", "not run", *["–"] * 7]
    same = {"mine": row("mine", 0.30, 0.34), "plain": row("plain", 0.20, 0.24)}
    assert [each.verdict for each in verdicts_of([table], same).values()] == ["holds"]


def test_a_claim_of_ones_own_counts_in_the_family_of_no_gap_alone_and_never_for_a_printed_one():
    """`sketch` has four printed claims; the fifth is `random` over `mono`, and a copy has one again without figures."""
    own = SKETCH._replace(claims=[("random", "dense")], rows=[e._replace(paper={OWN: None}) for e in SKETCH.rows])
    again = own._replace(name="again", claims=[("ours", "dense")])
    runs = {"ours": row("ours", 0.30, 0.34), "dense": row("dense", 0.20, 0.25)}
    for tables in ([again, own, SKETCH], [SKETCH, own, again]):
        (found,) = verdicts_of(tables, runs).values()
        assert found.claim.paper == pytest.approx(0.036)
        assert found.none == pytest.approx(min(1, 5 * found.claim.gap.p_none))
        assert found.size == pytest.approx(min(1, 4 * found.claim.p_size))


def test_a_table_of_ones_own_is_a_family_by_itself():
    mine = SKETCH._replace(name="mine", page="", claims=[("random", "dense"), ("mono", "dense")])
    runs = {"ours": row("ours", 0.30, 0.34), "dense": row("dense", 0.20, 0.25), "random": row("random", 0.1, 0.3)}
    alone = verdicts_of([SKETCH], runs)
    both = verdicts_of([SKETCH, mine], runs)
    assert {name: both[name] for name in alone} == alone
    assert len(both) > len(alone)


def test_a_judge_decides_only_the_claims_in_its_scores():
    """A copy of the table in mIoU has four claims more, of own voxels alone."""
    printed = [entry._replace(paper={"test/voxel/miou": entry.paper[OWN]}) for entry in SKETCH.rows]
    cells = SKETCH._replace(name="cells", order_by="test/voxel/miou", columns={"test/voxel/miou": "mIoU"}, rows=printed)
    runs = {"ours": row("ours", 0.30, 0.34, lidar=0.7), "wo_dilation": row("wo", 0.20, 0.25, lidar=0.7)}
    found = verdicts_of([SKETCH, cells], runs)
    families = {key: entry.none / entry.claim.gap.p_none for (*_, key), entry in found.items()}
    assert families == pytest.approx({OWN: 8, LIDAR: 4})


def test_a_claim_has_the_standard_error_over_streets_by_each_judge(tmp_path):
    """By street the gap is .1, 0, .4 of own voxels, and .3, .1, .5 of LiDAR rays."""
    better = [on_streets(tmp_path, "ours", seed, [0.5, 0.6, 0.9], [0.4, 0.4, 0.7]) for seed in range(2)]
    other = [on_streets(tmp_path, "dense", seed, [0.4, 0.6, 0.5], [0.1, 0.3, 0.2]) for seed in range(2)]
    for judge, gaps in ((VOXEL_RAYIOU, [0.1, 0.0, 0.4]), (SURFACE_RAYIOU, [0.3, 0.1, 0.5])):
        (claim,) = claims_of([SKETCH], {"ours": better, "dense": other}, judge).values()
        assert claim.streets == pytest.approx(stats.sem(gaps), abs=1e-6)


def on_streets(folder: Path, name: str, seed: int, own: list[float], lidar: list[float]) -> FinishedRun:
    """Return a run that finds these shares of the 100 rays of each street, and predicts nothing wrong."""

    def ray_counts(share: float) -> list[list[int]]:
        """Return for free and road the rays of the truth, those predicted, and those predicted right."""
        return [[0, 100], [0, round(100 * share)], [0, round(100 * share)]]

    scenes = {f"street-{k}": {RAYS: ray_counts(own[k]), LIDAR_RAYS: ray_counts(lidar[k])} for k in range(len(own))}
    place = folder / f"{name}-{seed:08x}"
    save_scenes(place, scenes, {}, ("Free", "Road"), (1.0,))
    scores = {OWN: sum(own) / len(own), LIDAR: sum(lidar) / len(lidar)}
    return FinishedRun(place.name, {"seed": seed}, scores, place)


def test_a_row_under_two_names_is_one_row():
    runs = {"ours": row("ours", 0.30, 0.31), "dense": row("dense", 0.20, 0.20), "wo_dilation": row("wo", 0.3, 0.32)}
    runs["ours@1000"] = runs["ours"]
    names = {"ours": "ours@1000"}
    renamed = SKETCH._replace(rows=[entry._replace(run=names.get(entry.run, entry.run)) for entry in SKETCH.rows])
    twice, once = (verdicts_of(tables, runs) for tables in ([SKETCH, renamed], [SKETCH]))
    assert twice == once


def test_a_claim_has_a_line_in_the_table_of_each_metric():
    better, other = [0.30, 0.34], [0.24, 0.25]
    runs = {"ours": row("ours", *better, lidar=0.6), "dense": row("dense", *other, lidar=0.6)}
    first, *_ = cells(SKETCH, runs, VOXEL_RAYIOU)
    apart = stats.ttest_ind(better, other, equal_var=False)
    p_size = stats.t(apart.df).cdf((0.075 - 0.0245106) / 0.0206155)
    # four claims of the table, of which one has run
    tests = [f"0.{100 * apart.pvalue:.0f} (0.{400 * apart.pvalue:.0f})", f"0.{100 * p_size:.0f} (1)"]
    title = ["Sketch ahead of all voxels", "Table VI"]
    gaps = ["+0.075 ± 0.021", "+0.036", "+0.025", "–"]
    assert first == [*title, "undecided", *gaps, "2 and 2", *tests]
    assert len(first) == len(HEAD)
    assert cells(SKETCH, runs, SURFACE_RAYIOU)[0][3:6] == ["+0.045 ± 0.012", "+0.036", "+0.015"]
    single = {"ours": row("ours", 0.3), "dense": row("dense", 0.2)}
    alone = [*title, "undecided (one seed only)", "+0.100", "+0.036", "+0.023", "–", "1 and 1", "–", "–"]
    assert cells(SKETCH, single, VOXEL_RAYIOU)[0] == alone
    assert {line[2] for line in cells(SKETCH, {}, VOXEL_RAYIOU)} == {"not run"}


def test_scores_of_bands_have_a_lidar_judge_and_other_metrics_have_none():
    distance = load_table(SWEEPS / "distance.yaml")
    assert metric_of(distance, SURFACE_RAYIOU) == "test/lidar/rayiou_0-8.5m"
    assert metric_of(distance._replace(order_by="test/depth/mae"), SURFACE_RAYIOU) is None


def test_rows_of_other_steps_are_other_claims():
    """`ours@1000` is `ours`, which stands in the table too; `dense@1000` and `dense@3000` are two rows."""
    printed = {row.run: row for row in SKETCH.rows}
    ours, dense = printed["ours"], printed["dense"]
    rows = [ours, ours._replace(run="ours@1000"), dense._replace(run="dense@1000"), dense._replace(run="dense@3000")]
    tables = [SKETCH._replace(rows=rows)]
    assert set(names_in([tables[0]._replace(steps="3000")]).values()) == {row.run for row in rows}
    names = names_in(tables)
    assert {names[other.run] for _, _, other in planned_claims(tables, VOXEL_RAYIOU)} == {
        "ours",
        "dense@1000",
        "dense@3000",
    }


KEY, TRUE = "test/rayiou", 100


def run(folder, name: str, shares: list[float]) -> FinishedRun:
    """Return a run that finds a share of the rays of each street and predicts nothing wrong: its score is the mean."""
    counted = {
        f"street-{k}": {RAYS: [[0, TRUE], [0, round(TRUE * share)], [0, round(TRUE * share)]]}
        for k, share in enumerate(shares)
    }
    save_scenes(folder / name, counted, {}, ("Free", "Road"), (1.0,))
    return FinishedRun(name, {}, {}, folder / name)


def test_of_a_mean_over_streets_it_is_that_of_the_mean(tmp_path):
    better, other = [0.5, 0.6, 0.9, 0.3, 0.7], [0.4, 0.6, 0.6, 0.2, 0.8]
    found = error_over_streets([run(tmp_path, "a", better)], [run(tmp_path, "b", other)], KEY)
    assert found == pytest.approx(stats.sem(np.subtract(better, other)))


def test_seeds_of_a_row_are_averaged_street_by_street(tmp_path):
    """One seed is good where the other is bad, so that the mean of both is the same in all streets."""
    seeds = [run(tmp_path, "a-0", [0.2, 0.8, 0.4]), run(tmp_path, "a-1", [0.8, 0.2, 0.6])]
    assert error_over_streets(seeds, [run(tmp_path, "b", [0.3, 0.3, 0.3])], KEY) == pytest.approx(0, abs=1e-6)


def test_it_is_unknown_without_the_same_streets_or_for_other_metrics(tmp_path):
    one, less = run(tmp_path, "a", [0.2, 0.8, 0.4]), run(tmp_path, "b", [0.2, 0.8])
    for pair, key in (
        (([one], [less]), KEY),
        (([one], [FinishedRun("c", {}, {}, tmp_path)]), KEY),
        (([one], [one]), "x"),
    ):
        assert math.isnan(error_over_streets(*pair, key))
