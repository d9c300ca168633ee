"""`report.py --compare` prints gap, error, seeds, p-value and verdict of rows, whatever has run."""

import json
from pathlib import Path

import pytest
from fake_scene import FakeWorld
from fake_sweep import CUBOID, CYLINDER, DENSE, OMNI, report, write_run

RUNS = {
    "ours": (OMNI, CYLINDER, [0.30, 0.34, 0.32]),
    "my_refiner": (OMNI, CYLINDER, [0.33, 0.36, 0.36]),
    "again": (OMNI, CYLINDER, [0.30, 0.34, 0.32]),
    "dense": (DENSE, CYLINDER, [0.20, 0.21]),
    "once": (OMNI, CYLINDER, [0.40]),
    "cuboid": (OMNI, CUBOID, [0.10, 0.12]),
}
FIRST = "preset=tiny, 40 steps, data "
AGAINST_DENSE = [
    "Warning: my_refiner and dense differ in steps of depth/sketch/model (8/5/40 and –/–/40).",
    # stats.ttest_ind([.33, .36, .36], [.20, .21], equal_var=False), and of half the scores
    "voxel RayIoU    gap +0.145 ± 0.011 (3 and 2 seeds), p 0.0014 (0.0029): my_refiner is ahead of dense",
    "surface RayIoU  gap +0.072 ± 0.006 (3 and 2 seeds), p 0.0014 (0.0029): my_refiner is ahead of dense",
]


@pytest.fixture
def made(tmp_path) -> Path:
    """Return a folder with the runs of `RUNS`."""
    world = FakeWorld(str(tmp_path / "data"))
    world.prepare()
    for row, (sketch, geometry, scores) in RUNS.items():
        for seed, score in enumerate(scores):
            write_run(tmp_path / "runs" / f"{row}-0000000{seed}", seed, score, world, sketch, geometry)
    return tmp_path / "runs"


def change(runs: Path, row: str, **facts: object) -> None:
    """Change recorded facts of all runs of a row."""
    for path in runs.glob(f"{row}-*/metrics.json"):
        path.write_text(json.dumps(json.loads(path.read_text()) | facts))


def compare(capsys, runs: Path, *rows: str) -> list[str]:
    report("--runs", str(runs), "--compare", *rows)
    return capsys.readouterr().out.splitlines()


def test_rows_of_one_depth_network_are_compared_by_seed_and_others_by_welch(made, capsys):
    """Of the three differences .03, .02, .04 the mean is .03, the error .01 / sqrt(3), and t = 5.196 has p = .0351."""
    setting, *lines = compare(capsys, made, "my_refiner", "omnidepth_occ", "dense")
    assert setting.startswith(FIRST)
    assert lines == [
        "voxel RayIoU    gap +0.030 ± 0.006 (3 seeds of both, paired), p 0.035 (0.035): my_refiner is ahead of "
        "omnidepth_occ",
        "surface RayIoU  gap +0.015 ± 0.003 (3 seeds of both, paired), p 0.035 (0.035): my_refiner is ahead of "
        "omnidepth_occ",
        *AGAINST_DENSE,
        "In brackets: p adjusted for 2 comparisons (Holm), which decides.",
    ]


def test_two_rows_need_no_adjustment_and_a_title_is_a_name(made, capsys):
    lines = compare(capsys, made, "OmniDepth-Occ", "my_refiner")[1:]
    assert [line.split("paired), ")[1] for line in lines] == ["p 0.035: OmniDepth-Occ is behind my_refiner"] * 2


def test_adjusted_p_values_decide(made, capsys):
    """Two comparisons have p = .0351, so that each has .0702 among both."""
    lines = compare(capsys, made, "my_refiner", "ours", "again")[1:-1]
    assert [line.split("paired), ")[1] for line in lines] == [
        f"p 0.035 (0.07): undecided between my_refiner and {row}" for row in ("ours", "ours", "again", "again")
    ]


def test_one_seed_decides_nothing(made, capsys):
    lines = compare(capsys, made, "once", "ours")[1:]
    assert lines == [
        "voxel RayIoU    gap +0.080 (1 and 3 seeds): one seed decides nothing between once and ours",
        "surface RayIoU  gap +0.040 (1 and 3 seeds): one seed decides nothing between once and ours",
    ]


def test_scores_of_other_protocols_are_not_compared(made, capsys):
    _, warning, *lines = compare(capsys, made, "ours", "cuboid")
    assert "grid (cylinder 8x10x4 and cuboid 8x8x4)" in warning
    assert lines[0] == (
        "voxel RayIoU    not compared: ours and cuboid have no such score in common, counted by one protocol"
    )
    assert lines[1].startswith("surface RayIoU  gap +0.105 ± ")


@pytest.mark.parametrize(
    ("facts", "told"),
    [
        ({"preset": "small"}, "preset (tiny and small)"),
        ({"data": "feedbeefcafe"}, "data ({data} and feedbeef)"),
        (
            {"steps": 400, "stages": {"depth": 8, "sketch": 5, "occupancy": 400}},
            "steps of depth/sketch/model (8/5/40 and 8/5/400)",
        ),
    ],
)
def test_rows_without_a_setting_in_common_are_compared_with_a_warning(made, capsys, facts, told):
    data = json.loads((made / "ours-00000000" / "metrics.json").read_text())["data"][:8]
    change(made, "my_refiner", **facts)
    warning, *lines = compare(capsys, made, "ours", "my_refiner")
    told = told.format(data=data)
    assert warning == f"Warning: ours and my_refiner have no setting in common: they differ in {told}."
    assert [line[:26] for line in lines] == ["voxel RayIoU    gap -0.030", "surface RayIoU  gap -0.015"]


def test_the_setting_in_which_both_rows_have_most_seeds_counts_and_another_can_be_named(made, capsys):
    for row in ("ours", "my_refiner"):
        (made / f"{row}-00000002").rename(made / f"kept-{row}")
        change(made, row, steps=400)
        (made / f"kept-{row}").rename(made / f"{row}-00000002")
    assert ", 400 steps, " in compare(capsys, made, "ours", "my_refiner")[0]
    setting, own, _ = compare(capsys, made, "ours@40", "my_refiner@40")
    assert ", 40 steps, " in setting
    assert "(1 and 1 seeds): one seed decides nothing between ours@40 and my_refiner@40" in own


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        (["my_refner", "ours"], "no finished run of row my_refner; with runs, nearest first: my_refiner, dense, "),
        (["ours", "bevdet"], "no finished run of row bevdet; with runs, nearest first: dense, "),
        (["ours"], "--compare needs two rows or more, each once: not ours"),
        (["ours", "omnidepth_occ"], "--compare needs two rows or more, each once: not ours omnidepth_occ"),
    ],
)
def test_wrong_rows_are_one_line(made, rows, message):
    with pytest.raises(SystemExit) as caught:
        report("--runs", str(made), "--compare", *rows)
    assert str(caught.value.code).startswith(message)
    assert len(str(caught.value.code).splitlines()) == 1
