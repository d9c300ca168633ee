"""All claims in one list."""

from pathlib import Path

from omniocc.report.runs import FinishedRun
from omniocc.report.tables.claims import verdicts_of
from omniocc.report.tables.paper import load_table
from omniocc.report.tables.verdicts import CSV_HEAD, csv_lines, verdicts_parts

SKETCH = load_table(Path(__file__).parents[3] / "sweeps" / "sketch.yaml")


def row(name: str, *values: float) -> list[FinishedRun]:
    return [FinishedRun(f"{name}-{k:08x}", {"seed": k}, {"test/rayiou": value}) for k, value in enumerate(values)]


def test_claims_stand_once_and_by_verdict():
    runs = {
        "ours": row("ours", 0.300, 0.301, 0.302),
        "wo_dilation": row("wo", 0.29, 0.31, 0.30),
        "random": row("random", 0.200, 0.201, 0.202),
    }
    again = SKETCH._replace(name="again", title="Again")
    part, surface, _ = verdicts_parts([SKETCH, again], runs, verdicts_of([SKETCH, again], runs))
    lines = part.cells[1]
    assert (part.title, surface.title) == ("Claims by voxel RayIoU", "Claims by surface RayIoU")
    assert [(line[0], line[2]) for line in lines] == [
        ("Sketch ahead of random voxels", "holds"),
        ("Dilation helps", "undecided"),
        ("Omnidirectional ahead of monocular depth", "not run"),
        ("Sketch ahead of all voxels", "not run"),
    ]
    assert lines[0][3:8] == ["+0.100 ± 0.001", "+0.069", "+0.044", "–", "3 and 3"]
    assert {line[2] for line in surface.cells[1]} == {"not compared: other protocols", "not run"}
    assert verdicts_parts([], {}, {}) == []


def test_rows_that_share_the_depth_are_judged_again_by_paired_differences():
    """The noise of the row without dilation hides the gap to random voxels, whose own differences hardly vary."""
    part = SKETCH._replace(rows=[each._replace(alone=False) for each in SKETCH.rows])
    runs = {
        "ours": row("ours", 0.300, 0.301, 0.302),
        "wo_dilation": row("wo", 0.26, 0.36, 0.30),
        "random": row("random", 0.200, 0.2011, 0.202),
    }
    decided = verdicts_of([part], runs)
    *_, (_, title, _, (_, lines)) = verdicts_parts([part], runs, decided)
    assert title == "Claims by paired differences"
    wo_dilation, random = lines
    assert wo_dilation[3:] == ["undecided", "undecided", "-0.006 ± 0.029", "0.86 (1)", "3"]
    assert random[:3] == ["Sketch ahead of random voxels", "Table VI", "voxel RayIoU"]
    assert random[3:6] == ["undecided", "holds", "+0.100 ± 0.000"]
    (line, other) = (dict(zip(CSV_HEAD, each, strict=True)) for each in csv_lines([part], runs, decided, "1000"))
    assert (line["claim"], line["steps"], line["paired verdict"]) == ("Dilation helps", "1000", "undecided")
    assert (other["gap here"], other["paired gap"], other["seeds in common"]) == ("0.0999667", "0.0999667", "3")


def test_rows_with_other_depth_networks_are_not_paired():
    again = [run._replace(metrics=run.metrics | {"test/depth/mae": 1.5}) for run in row("wo", 0.26, 0.36, 0.30)]
    runs = {"ours": row("ours", 0.300, 0.301, 0.302), "wo_dilation": again}
    decided = verdicts_of([SKETCH], runs)
    assert [part.name for part in verdicts_parts([SKETCH], runs, decided)] == ["claims-voxel", "claims-surface"]
    assert verdicts_of([SKETCH], runs, paired=True) == decided


def test_systems_are_not_paired():
    runs = {"ours": row("ours", 0.3, 0.31, 0.32), "random": row("random", 0.2, 0.22, 0.21)}
    decided = verdicts_of([SKETCH], runs)
    assert [part.name for part in verdicts_parts([SKETCH], runs, decided)] == ["claims-voxel", "claims-surface"]
    assert verdicts_of([SKETCH], runs, paired=True) == decided
