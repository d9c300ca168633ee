"""The same claims after more steps."""

import math
from itertools import pairwise
from pathlib import Path

import pytest
from scipy import stats

from omniocc.report.chapters import CURVES_IMAGE, longer_chapter, write_docs
from omniocc.report.plots.figures import learning_curves
from omniocc.report.runs import FinishedRun
from omniocc.report.sweep import Sweep
from omniocc.report.tables import training
from omniocc.report.tables.claims import Claim, Judged
from omniocc.report.tables.gaps import Gap
from omniocc.report.tables.paper import load_table
from report import draw_curves

SWEEPS = Path(__file__).parents[3] / "sweeps"
SKETCH = load_table(SWEEPS / "sketch.yaml")


def runs(folder: Path, name: str, steps: int, *scores: float) -> list[FinishedRun]:
    found = []
    for seed, score in enumerate(scores):
        place = folder / f"{name}-{steps:08d}-{seed}"
        (place / "csv" / "version_0").mkdir(parents=True)
        lines = [
            "step,val/rayiou",
            f"{steps // 10},{score / 2}",
            f"{steps // 2 - 1},{score - 0.02}",
            f"{steps},{score}",
        ]
        (place / "csv" / "version_0" / "metrics.csv").write_text("\n".join(lines) + "\n")
        facts = {"seed": seed, "preset": "tiny", "steps": steps, "data": "d"}
        found.append(FinishedRun(place.name, facts, {"test/rayiou": score, "test/rayiou_0-8.5m": score}, place))
    return found


@pytest.fixture
def sweep(tmp_path) -> Sweep:
    """At 100 steps `ours` is behind the row without dilation, at 1,000 ahead; `dense` has no longer run."""
    rows = {
        "ours": runs(tmp_path, "ours", 100, 0.20, 0.21), "dense": runs(tmp_path, "dense", 100, 0.15, 0.16),
        "wo_dilation": runs(tmp_path, "wo_dilation", 100, 0.30, 0.31),
    }  # fmt: skip
    longer = {
        "ours": runs(tmp_path, "ours", 1000, 0.400, 0.412),
        "wo_dilation": runs(tmp_path, "wo_dilation", 1000, 0.350, 0.360),
    }
    short, long = (
        Sweep([run for each in of.values() for run in each], of, "", "", [SKETCH], []) for of in (rows, longer)
    )
    return short._replace(longer=[long])


def test_a_claim_is_told_for_both_numbers_of_steps(sweep):
    sweeps = training.by_steps(sweep)
    (claim,) = training.compared(sweeps)
    head, (line,) = training.change_cells([claim], sweeps)
    assert head == [
        "claim", "paper", "judge", "at 100 steps", "verdict", "at 1000 steps", "verdict", "change",
        "no change: p (Holm)", "changes",
    ]  # fmt: skip
    assert line == [
        "omni depth ahead of omni depth w/o dilation", "+0.005", "own voxels", "-0.100 ± 0.000",
        "does not hold (opposite sign)", "+0.051 ± 0.001", "holds", "+0.151 ± 0.001", ".0042 (.017)", "yes",
    ]  # fmt: skip


def compared(judge: str, *gaps: Gap) -> training.Compared:
    found = {str(place): Judged(Claim(0.1, 0.1, gap), 0.0, 1.0) for place, gap in enumerate(gaps)}
    return training.Compared("a ahead of b", judge, found)


def test_changes_are_adjusted_within_a_judge():
    """SKETCH has four claims, of which two have run by own voxels and one by LiDAR rays; the last has one seed."""
    moved, stayed = (Gap(0.1, 0.01, 4), Gap(0.2, 0.01, 4)), (Gap(0.1, 0.01, 4), Gap(0.1, 0.01, 4))
    unknown = Gap(0.1, 0.01, 4), Gap(0.2, math.nan, 0)
    claims = [compared("own voxels", *moved), compared("own voxels", *stayed), compared("LiDAR rays", *moved)]
    first, second, alone, none = training.adjusted_changes([*claims, compared("LiDAR rays", *unknown)], [SKETCH])
    p_value = 2 * stats.t.sf(0.1 / math.hypot(0.01, 0.01), 8)
    assert (first, second, alone) == (pytest.approx(4 * p_value), 1.0, pytest.approx(4 * p_value))
    assert math.isnan(none)
    sweeps = {steps: Sweep([], {}, "", "", [SKETCH], []) for steps in "01"}
    _, lines = training.change_cells([claims[1], compared("LiDAR rays", *unknown)], sweeps)
    assert [line[-3:] for line in lines] == [
        ["+0.000 ± 0.014", "1 (1)", "not found"], ["+0.100", "–", "unknown"],
    ]  # fmt: skip


def test_rows_on_other_data_are_compared_at_the_same_steps(sweep, tmp_path):
    rows = {f"voxformer_pinhole@{steps}": runs(tmp_path, "pinhole", steps, 0.1, 0.12) for steps in (100, 1000)}
    comparison = load_table(SWEEPS / "comparison.yaml")
    short, long = (
        each._replace(tables=[comparison.of_steps(steps)], lengths=rows)
        for each, steps in ((sweep, "100"), (sweep.longer[0], "1000"))
    )
    both = short._replace(longer=[long])
    (claim,) = training.compared(training.by_steps(both))
    assert claim.title == "OmniDepth-Occ ahead of VoxFormer"
    assert [round(found.claim.gap.here, 3) for found in claim.found.values()] == [0.095, 0.296]
    text = training.chapter(both)
    assert "| voxformer_pinhole | 0.110 ± 0.014 | 0.110 ± 0.014 | – | – |" in text
    assert "| voxformer_pinhole | 1000 | 0.055 | 0.055 | 0.090 | 0.090 | 0.110 |" in text


def test_claims_on_a_band_of_distance_name_it(sweep, tmp_path):
    systems = {steps: {"bevdet": runs(tmp_path, "bevdet", steps, 0.1, 0.12)} for steps in (100, 1000)}
    distance = load_table(SWEEPS / "distance.yaml")
    short, long = (
        each._replace(tables=[distance.of_steps(str(steps))], rows={**each.rows, **systems[steps]})
        for each, steps in ((sweep, 100), (sweep.longer[0], 1000))
    )
    (claim,) = training.compared(training.by_steps(short._replace(longer=[long])))
    assert claim.title == "OmniDepth-Occ ahead of BEVDet, 0-8.5 m"


def test_the_page_has_scores_claims_and_curves(sweep):
    text = training.chapter(sweep)
    assert "| ours | 0.205 ± 0.007 | 0.406 ± 0.008 | – | – |" in text
    assert "| dense |" not in text
    assert "| ours | 1000 | 0.203 | 0.203 | 0.386 | 0.386 | 0.406 |" in text
    assert training.chapter(sweep._replace(longer=[])) == ""


def test_runs_of_other_rows_with_more_steps_have_no_columns(sweep, tmp_path):
    budget = {"dense_budget": runs(tmp_path, "dense_budget", 310, 0.2, 0.3)}
    other = sweep._replace(runs=[*budget["dense_budget"]], rows=budget)
    both = sweep._replace(longer=[other, *sweep.longer])
    assert training.chapter(both) == training.chapter(sweep)
    assert training.parts_of(sweep._replace(longer=[other])) == []


def test_the_picture_has_a_line_for_each_row_and_number_of_steps(sweep):
    """The curves of `runs` reach half of the score, the score less .02, and the score."""
    (axes,) = learning_curves(training.runs_by_row(sweep)).axes
    drawn = {(line.get_linestyle(), *line.get_xdata()): list(line.get_ydata()) for line in axes.lines}
    assert [line.get_label() for line in axes.lines if line.get_linestyle() == "-"] == ["ours", "wo_dilation"]
    assert len(axes.lines) == 4
    assert drawn["--", 10, 49, 100] == pytest.approx([0.1525, 0.285, 0.305])
    assert drawn["-", 100, 499, 1000] == pytest.approx([0.1775, 0.335, 0.355])


def test_the_page_of_the_documentation_has_the_picture_beside_it(sweep, tmp_path):
    (page,) = (path for path in write_docs([sweep], tmp_path) if path.name == "training.md")
    assert page.read_text().rstrip().endswith(f"({CURVES_IMAGE})")
    lines = page.read_text().splitlines()
    headings = [line.split(" ")[0] for line in lines if line.startswith("#")]
    assert headings == ["#", "##", "##"]
    assert [line for line, after in pairwise(lines) if line.startswith("|") and after[:1] not in ("|", "")] == []
    draw_curves(sweep, tmp_path)
    first = (tmp_path / CURVES_IMAGE).read_bytes()
    draw_curves(sweep, tmp_path)
    assert first.startswith(b"<?xml")
    assert (tmp_path / CURVES_IMAGE).read_bytes() == first


def test_more_steps_have_a_page_of_their_tables_without_rows_that_have_not_run(sweep, tmp_path):
    (page,) = (path for path in write_docs([sweep], tmp_path) if path.name.startswith("steps_"))
    lines = page.read_text().splitlines()
    assert page.name == "steps_1000.md"
    headings = [line for line in lines if line.startswith("#")]
    assert headings[:2] == ["# The tables at 1000 steps", "## All claims"]
    assert f"## {SKETCH.title}" in headings
    begin = lines.index(f"## {SKETCH.title}")
    figures = [line.split(" | ")[0] for line in lines[begin:] if "| here, 2 seeds |" in line]
    assert figures == ["| omni depth", "| omni depth w/o dilation"]
    assert not any("here: not run" in line for line in lines)
    assert any(line.startswith("4 runs, seeds 0, 1; preset=tiny, 1000 steps") for line in lines)


def test_a_table_of_one_row_with_more_steps_is_left_out(sweep, tmp_path):
    (longer,) = sweep.longer
    alone = longer._replace(rows={"ours": longer.rows["ours"]}, runs=[*longer.rows["ours"]])
    assert f"## {SKETCH.title}" not in longer_chapter(alone, "100")
    assert f"## {SKETCH.title}" in longer_chapter(longer, "100")


def test_without_longer_runs_there_is_no_picture(sweep, tmp_path):
    draw_curves(sweep._replace(longer=[]), tmp_path)
    assert not (tmp_path / CURVES_IMAGE).exists()
    assert not [path for path in write_docs([sweep._replace(longer=[])], tmp_path) if path.name.startswith("steps_")]


def test_the_change_is_from_the_fewest_to_the_most_steps():
    claim = compared("own voxels", Gap(0.1, 0.0, 4), Gap(0.5, 0.0, 4), Gap(0.2, 0.0, 4))
    assert claim.change.here == pytest.approx(0.1)
