"""The same claims after more steps."""

import csv
import math
from itertools import pairwise
from pathlib import Path

import pytest
from scipy import stats

from omniocc.report.docs import CURVES_IMAGE, draw_curves, write_docs
from omniocc.report.plots import learning_curves
from omniocc.report.runs import FinishedRun
from omniocc.report.sweep import Sweep
from omniocc.report.tables import training
from omniocc.report.tables.claims import Claim, Judged
from omniocc.report.tables.gaps import Gap
from omniocc.report.tables.paper import load_table
from omniocc.runs.curves import read_curves
from omniocc.runs.table import SURFACE_RAYIOU, VOXEL_RAYIOU

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
        metrics, curves = {"test/rayiou": score, "test/rayiou_0-8.5m": score}, read_curves(place)
        found.append(FinishedRun(place.name, facts, metrics, place, curves=curves))
    return found


@pytest.fixture
def sweep(tmp_path) -> Sweep:
    """At 100 steps `ours` is behind the row without dilation, at 1,000 ahead; `dense` has no longer run."""
    rows = {
        "ours": runs(tmp_path, "ours", 100, 0.20, 0.21),
        "dense": runs(tmp_path, "dense", 100, 0.15, 0.16),
        "wo_dilation": runs(tmp_path, "wo_dilation", 100, 0.30, 0.31),
    }
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
    (claim,) = training.compare_training(sweeps)
    head, (line,) = training.change_cells([claim], sweeps)
    assert head == [
        "Claim",
        "Metric",
        "100 steps",
        "Verdict",
        "1,000 steps",
        "Verdict",
        "Change",
        "No change: p",
        "Changes",
    ]
    assert line == [
        "Dilation helps",
        VOXEL_RAYIOU,
        "-0.100 ± 0.000",
        "does not hold (opposite sign)",
        "+0.051 ± 0.001",
        "holds",
        "+0.151 ± 0.001",
        "0.0042 (0.017)",
        "yes",
    ]


def compared(judge: str, *gaps: Gap) -> training.Compared:
    found = [Judged(Claim(0.1, 0.1, gap), 0.0, 1.0) for gap in gaps]
    return training.Compared("a ahead of b", judge, found)


def test_changes_are_adjusted_within_a_judge():
    """SKETCH has four claims, of which two have run by own voxels and one by LiDAR rays; the last has one seed."""
    moved, stayed = (Gap(0.1, 0.01, 4), Gap(0.2, 0.01, 4)), (Gap(0.1, 0.01, 4), Gap(0.1, 0.01, 4))
    unknown = Gap(0.1, 0.01, 4), Gap(0.2, math.nan, 0)
    claims = [compared(VOXEL_RAYIOU, *moved), compared(VOXEL_RAYIOU, *stayed), compared(SURFACE_RAYIOU, *moved)]
    first, second, alone, none = training.adjusted_changes([*claims, compared(SURFACE_RAYIOU, *unknown)], [SKETCH])
    p_value = 2 * stats.t.sf(0.1 / math.hypot(0.01, 0.01), 8)
    assert (first, second, alone) == (pytest.approx(4 * p_value), 1.0, pytest.approx(4 * p_value))
    assert math.isnan(none)
    sweeps = {steps: Sweep([], {}, "", "", [SKETCH], []) for steps in "01"}
    _, lines = training.change_cells([claims[1], compared(SURFACE_RAYIOU, *unknown)], sweeps)
    assert [line[-3:] for line in lines] == [
        ["+0.000 ± 0.014", "1 (1)", "not found"],
        ["+0.100", "–", "unknown"],
    ]


def test_rows_on_other_data_are_compared_at_the_same_steps(sweep, tmp_path):
    rows = {f"voxformer_pinhole@{steps}": runs(tmp_path, "pinhole", steps, 0.1, 0.12) for steps in (100, 1000)}
    comparison = load_table(SWEEPS / "comparison.yaml")
    short, long = (
        each._replace(tables=[comparison.of_steps(steps)], lengths=rows)
        for each, steps in ((sweep, "100"), (sweep.longer[0], "1000"))
    )
    both = short._replace(longer=[long])
    (claim,) = training.compare_training(training.by_steps(both))
    assert claim.title == "OmniDepth-Occ ahead of VoxFormer"
    assert [round(found.claim.gap.here, 3) for found in claim.found if found] == [0.095, 0.296]
    short, long = (line for line in csv_of(both) if line["row"] == "voxformer_pinhole")
    assert [line["voxel RayIoU, mean"] for line in (short, long)] == ["0.11", "0.11"]
    assert [long[column] for column in list(long)[-5:]] == ["0.055", "0.055", "0.09", "0.09", "0.11"]
    (path,) = (path for path in write_docs([both], tmp_path) if path.name == "comparison.csv")
    lines = [line for line in csv.DictReader(path.read_text().splitlines()) if line["row"] == "voxformer_pinhole"]
    assert [line["steps"] for line in lines if line["key"] == "test/rayiou"] == ["100", "1000"]


def test_claims_on_a_band_of_distance_name_it(sweep, tmp_path):
    systems = {steps: {"bevdet": runs(tmp_path, "bevdet", steps, 0.1, 0.12)} for steps in (100, 1000)}
    distance = load_table(SWEEPS / "distance.yaml")
    short, long = (
        each._replace(tables=[distance.of_steps(str(steps))], rows={**each.rows, **systems[steps]})
        for each, steps in ((sweep, 100), (sweep.longer[0], 1000))
    )
    (claim,) = training.compare_training(training.by_steps(short._replace(longer=[long])))
    assert claim.title == "OmniDepth-Occ ahead of BEVDet, 0-8.5 m"


def csv_of(sweep: Sweep) -> list[dict[str, str]]:
    text = training.training_csv(training.runs_by_row(sweep), {"ours": "OmniDepth-Occ"})
    return list(csv.DictReader(text.splitlines()))


def test_the_file_has_scores_and_curves(sweep):
    first, second, *others = csv_of(sweep)
    assert (first["method"], first["steps"], first["voxel RayIoU, mean"]) == ("OmniDepth-Occ", "100", "0.205")
    assert (second["steps"], second["voxel RayIoU, mean"]) == ("1000", "0.406")
    assert second["voxel RayIoU, standard error"] == "0.006"
    assert [second[column] for column in list(second)[-5:]] == ["0.203", "0.203", "0.386", "0.386", "0.406"]
    assert {line["row"] for line in others} == {"wo_dilation"}
    assert training.changes_part(sweep._replace(longer=[])) == []


def test_runs_of_other_rows_with_more_steps_have_no_columns(sweep, tmp_path):
    budget = {"dense_budget": runs(tmp_path, "dense_budget", 310, 0.2, 0.3)}
    other = sweep._replace(runs=[*budget["dense_budget"]], rows=budget)
    both = sweep._replace(longer=[other, *sweep.longer])
    assert training.changes_part(both) == training.changes_part(sweep)
    assert csv_of(both) == csv_of(sweep)
    assert training.changes_part(sweep._replace(longer=[other])) == []


def test_the_picture_has_a_line_for_each_row_and_number_of_steps(sweep):
    """The curves of `runs` reach half of the score, the score less .02, and the score."""
    (axes,) = learning_curves(training.runs_by_row(sweep)).axes
    drawn = {(line.get_linestyle(), *line.get_xdata()): list(line.get_ydata()) for line in axes.lines}
    assert [line.get_label() for line in axes.lines if line.get_linestyle() == "-"] == ["ours", "wo_dilation"]
    assert len(axes.lines) == 4
    assert drawn["--", 10, 49, 100] == pytest.approx([0.1525, 0.285, 0.305])
    assert drawn["-", 100, 499, 1000] == pytest.approx([0.1775, 0.335, 0.355])


def test_the_page_of_claims_has_the_changes_and_the_picture(sweep, tmp_path):
    (page,) = (path for path in write_docs([sweep], tmp_path) if path.name == "claims.md")
    lines = page.read_text().splitlines()
    assert [line for line in lines if line.startswith("## ")][-2:] == [f"## {training.TITLE}", "## Learning curves"]
    (image,) = (line.partition("](")[2].rstrip(")") for line in lines if line.startswith("!["))
    assert [line for line, after in pairwise(lines) if line.startswith("|") and after[:1] not in ("|", "")] == []
    draw_curves(sweep, tmp_path)
    first = (page.parent / image).read_bytes()
    draw_curves(sweep, tmp_path)
    assert first.startswith(b"<?xml")
    assert (tmp_path / CURVES_IMAGE).read_bytes() == first


def test_the_files_of_tables_have_more_steps_without_rows_that_have_not_run(sweep, tmp_path):
    (path,) = (path for path in write_docs([sweep], tmp_path) if path.name == "sketch.csv")
    lines = [line for line in csv.DictReader(path.read_text().splitlines()) if line["key"] == "test/rayiou"]
    assert [line["row"] for line in lines if line["steps"] == "1000"] == ["ours", "wo_dilation"]
    assert [line["mean"] for line in lines if line["row"] == "ours"] == ["0.205", "0.406"]


def test_without_longer_runs_there_is_no_picture(sweep, tmp_path):
    alone = sweep._replace(longer=[])
    draw_curves(alone, tmp_path)
    assert not (tmp_path / CURVES_IMAGE).exists()
    (page,) = (path for path in write_docs([alone], tmp_path) if path.name == "claims.md")
    assert "![" not in page.read_text()


def test_the_change_is_from_the_fewest_to_the_most_steps():
    claim = compared(VOXEL_RAYIOU, Gap(0.1, 0.0, 4), Gap(0.5, 0.0, 4), Gap(0.2, 0.0, 4))
    assert claim.change.here == pytest.approx(0.1)
