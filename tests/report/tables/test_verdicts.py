"""All claims in one list."""

from pathlib import Path

from omniocc.report.runs import FinishedRun
from omniocc.report.tables.claims import judged
from omniocc.report.tables.paper import load_table
from omniocc.report.tables.verdicts import verdicts_chapter

SKETCH = load_table(Path(__file__).parents[3] / "sweeps" / "sketch.yaml")


def row(name: str, *values: float) -> list[FinishedRun]:
    return [FinishedRun(f"{name}-{k:08x}", {"seed": k}, {"test/rayiou": value}) for k, value in enumerate(values)]


def test_claims_stand_once_and_by_verdict():
    runs = {
        "ours": row("ours", 0.300, 0.301, 0.302), "wo_dilation": row("wo", 0.29, 0.31, 0.30),
        "random": row("random", 0.200, 0.201, 0.202),
    }  # fmt: skip
    again = SKETCH._replace(name="again", title="Again")
    text = verdicts_chapter([SKETCH, again], runs, judged([SKETCH, again], runs))
    lines = [line.strip("| ").split(" | ") for line in text.splitlines() if " ahead of " in line]
    assert [(line[0].removeprefix("omni depth ahead of "), line[5]) for line in lines] == [
        ("random voxels", "holds"), ("omni depth w/o dilation", "undecided"),
        ("mono depth", "not run"), ("dense voxels", "not run"),
    ]  # fmt: skip
    assert lines[0][1:] == [
        SKETCH.title, "+0.069", "+0.044", "3 and 3", "holds", "+0.100 ± 0.001", "–", "–",
    ]  # fmt: skip
    assert verdicts_chapter([], {}, {}) == ""
