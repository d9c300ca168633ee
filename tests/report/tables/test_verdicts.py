"""All claims in one list."""

from pathlib import Path

from omniocc.report.runs import FinishedRun
from omniocc.report.tables.claims import judged
from omniocc.report.tables.paper import load_table
from omniocc.report.tables.verdicts import verdicts_parts

SKETCH = load_table(Path(__file__).parents[3] / "sweeps" / "sketch.yaml")


def row(name: str, *values: float) -> list[FinishedRun]:
    return [FinishedRun(f"{name}-{k:08x}", {"seed": k}, {"test/rayiou": value}) for k, value in enumerate(values)]


def test_claims_stand_once_and_by_verdict():
    runs = {
        "ours": row("ours", 0.300, 0.301, 0.302), "wo_dilation": row("wo", 0.29, 0.31, 0.30),
        "random": row("random", 0.200, 0.201, 0.202),
    }  # fmt: skip
    again = SKETCH._replace(name="again", title="Again")
    part, _ = verdicts_parts([SKETCH, again], runs, judged([SKETCH, again], runs))
    lines = part.cells[1]
    assert [(line[0].removeprefix("omni depth ahead of "), line[5]) for line in lines] == [
        ("random voxels", "holds"), ("omni depth w/o dilation", "undecided"),
        ("mono depth", "not run"), ("dense voxels", "not run"),
    ]  # fmt: skip
    assert lines[0][1:] == [
        SKETCH.title, "+0.069", "+0.044", "3 and 3", "holds", "+0.100 ± 0.001", "–", "–",
    ]  # fmt: skip
    assert verdicts_parts([], {}, {}) == []


def test_rows_that_share_the_depth_are_judged_again_by_paired_differences():
    """The noise of the row without dilation hides the gap to random voxels, whose own differences hardly vary."""
    part = SKETCH._replace(rows=[each._replace(alone=False) for each in SKETCH.rows])
    runs = {
        "ours": row("ours", 0.300, 0.301, 0.302), "wo_dilation": row("wo", 0.26, 0.36, 0.30),
        "random": row("random", 0.200, 0.2011, 0.202),
    }  # fmt: skip
    decided = judged([part], runs)
    _, (_, title, _, (_, lines)) = verdicts_parts([part], runs, decided)
    assert title == "The same by paired differences"
    wo_dilation, random = lines
    assert wo_dilation[3:] == ["3", "-0.006 ± 0.029", ".86 (1)", "undecided", "undecided", "no"]
    assert random[:5] == ["omni depth ahead of random voxels", SKETCH.title, "own voxels", "3", "+0.100 ± 0.000"]
    assert random[6:] == ["holds", "undecided", "yes"]


def test_rows_with_other_depth_networks_are_not_paired():
    again = [run._replace(metrics=run.metrics | {"test/depth/mae": 1.5}) for run in row("wo", 0.26, 0.36, 0.30)]
    runs = {"ours": row("ours", 0.300, 0.301, 0.302), "wo_dilation": again}
    decided = judged([SKETCH], runs)
    assert [part.name for part in verdicts_parts([SKETCH], runs, decided)] == ["claims"]
    assert judged([SKETCH], runs, paired=True) == decided


def test_systems_are_not_paired():
    runs = {"ours": row("ours", 0.3, 0.31, 0.32), "random": row("random", 0.2, 0.22, 0.21)}
    decided = judged([SKETCH], runs)
    assert [part.name for part in verdicts_parts([SKETCH], runs, decided)] == ["claims"]
    assert judged([SKETCH], runs, paired=True) == decided
