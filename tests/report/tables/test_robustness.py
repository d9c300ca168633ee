import csv
import math

import pytest

from omniocc.report.runs import FinishedRun
from omniocc.report.sweep import with_training
from omniocc.report.tables.formats import parts_text
from omniocc.report.tables.robustness import (
    common_parts,
    comparable,
    page_parts,
    part_cells,
    relative_cells,
    report_parts,
    robustness_csv,
    system_names,
    verdict,
)
from omniocc.runs.robustness import UNDISTURBED, PartScores, Robustness


def part(name, group, score, near):
    scores = {"rayiou": score, "rayiou_within_8.5m": near, "voxel/miou": score / 2}
    without = {key: [value - 0.01, value, value + 0.01] for key, value in scores.items()}
    return PartScores(name, group, ["a", "b", "c"], 6, 12.0, scores, without=without)


def record(system, base, noise, views, setting="same"):
    parts = [part(UNDISTURBED, UNDISTURBED, base, 0.6), part("noise_5_percent", "noise", noise, 0.5)]
    parts += [part(f"view_{deg}_deg", "view", score, 0.4) for deg, score in views.items()]
    facts = {"setting": setting, "seed": 0, "command": "python src/evaluate.py", "commit": "abc", "machine": "here"}
    return Robustness(system, facts, parts)


OURS = record("ours-12345678", 0.5, 0.45, {180: 0.3, 90: 0.2})
OTHER = record("flashocc-12345678", 0.4, 0.38, {180: 0.12})


def test_relative_drops_are_means_by_kind_over_common_disturbances_with_the_least_in_bold():
    assert common_parts([OURS, OTHER]) == ["noise_5_percent", "view_180_deg"]
    head, rows = relative_cells([OURS, OTHER])
    assert head == ["Loss of voxel RayIoU, %", "ours", "flashocc"]
    assert rows == [
        ["undisturbed voxel RayIoU", "0.500", "0.400"],
        ["noise", "10.0", "**5.0**"],
        ["view", "**40.0**", "70.0"],
        ["mean of all kinds", "**25.0**", "37.5"],
        ["voxel RayIoU after it", "0.375", "0.250"],
    ]
    assert relative_cells([OURS])[1][2] == ["view", "50.0"]  # both views; nothing in bold


def test_the_verdict_names_who_loses_least():
    assert verdict([OURS, OTHER]) == "ours loses least: 25.0 % in the mean over kinds."
    assert verdict([OURS]) == "ours loses least: 30.0 % in the mean over kinds."
    assert verdict([OURS, OTHER._replace(parts=OTHER.parts[:1])]) == ""
    nothing = record("mono-12345678", 0.0, 0.0, {180: 0.0})  # it has nothing to lose
    assert verdict([nothing, OURS, OTHER]) == verdict([OURS, OTHER, nothing]) == verdict([OURS, OTHER])


def test_every_disturbance_has_a_line_with_the_standard_error():
    head, rows = part_cells([OURS, OTHER])
    assert head == ["loss of voxel RayIoU", "ours", "flashocc"]
    assert rows[0] == ["noise_5_percent", "0.050 (0.000)", "0.020 (0.000)"]
    assert rows[2] == ["view_90_deg", "0.300 (0.000)", "–"]


def test_the_file_has_all_scores_and_nested_ranges_and_where_they_come_from():
    first, _, third, *_ = csv.DictReader(robustness_csv([OURS, OTHER], {"ours": "OmniDepth-Occ"}).splitlines())
    assert (first["method"], first["voxel RayIoU"], first["mIoU"]) == ("OmniDepth-Occ", "0.5", "0.25")
    assert (first["command"], first["scenes"], first["frames"]) == ("python src/evaluate.py", "3", "6")
    assert (third["disturbance"], third["voxel RayIoU, loss"], third["mIoU, loss"]) == ("view_180_deg", "0.2", "0.1")
    assert third["voxel RayIoU within 8.5m, loss"] == "0.2"
    assert (third["relative loss of voxel RayIoU"], third["command"]) == ("0.4", "")


def test_each_score_has_its_own_standard_error():
    """Without each scene in turn RayIoU drops by .1, .2, .3, mIoU by twice that; jackknife: root of 2/3 (.1² + .1²)."""
    noise = part("noise_5_percent", "noise", 0.3, 0.5)
    base = part(UNDISTURBED, UNDISTURBED, 0.5, 0.6)
    base = base._replace(without=base.without | {"rayiou": [0.4, 0.5, 0.6], "voxel/miou": [0.8, 1.0, 1.2]})
    noise = noise._replace(without=noise.without | {"rayiou": [0.3, 0.3, 0.3], "voxel/miou": [0.6, 0.6, 0.6]})
    system = OURS._replace(parts=[base, noise])
    assert part_cells([system])[1] == [["noise_5_percent", "0.200 (0.115)"]]
    _, disturbed = csv.DictReader(robustness_csv([system], {}).splitlines())
    errors = [disturbed[f"{title}, standard error over scenes"] for title in ("voxel RayIoU", "mIoU")]
    assert errors == ["0.11547", "0.23094"]


def test_systems_of_other_scenes_are_not_compared():
    tiny = record("tiny", 0.6, 0.5, {180: 0.4}, setting="another")
    assert [[one.system for one in group] for group in comparable([tiny, OURS, OTHER])] == [
        ["ours-12345678", "flashocc-12345678"],
        ["tiny"],
    ]
    page = parts_text(report_parts([tiny, OURS, OTHER]))
    assert page.count("| undisturbed voxel RayIoU |") == 2
    assert "| Loss of voxel RayIoU, % | ours | flashocc |" in page
    assert "tiny: 3 scenes, 6 frames, disturbances of seed 0; `python src/evaluate.py`, commit abc, here." in page


def test_systems_of_one_row_are_told_apart():
    long = record("flashocc-87654321", 0.5, 0.4, {180: 0.4})
    assert system_names([OTHER, long]) == ["flashocc-12345678", "flashocc-87654321"]
    alike = [one._replace(training="1000 steps, seed 0") for one in (OTHER, long)]
    assert system_names(alike) == ["flashocc-12345678", "flashocc-87654321"]
    group = [OURS, OTHER._replace(training="1000 steps, seed 0"), long._replace(training="10000 steps, seed 1")]
    names = ["ours", "flashocc, 1000 steps, seed 0", "flashocc, 10000 steps, seed 1"]
    assert system_names(group) == relative_cells(group)[0][1:] == part_cells(group)[0][1:] == names
    assert verdict(group).startswith("flashocc, 10000 steps, seed 1 loses least: ")  # 20 and 20 %; 10 and 40; 5 and 70
    assert "flashocc, 1000 steps, seed 0: 3 scenes" in parts_text(report_parts(group))


def test_the_page_has_means_over_seeds_apart_by_steps():
    """Of views one seed loses 70 % and the other 20 %, of noise 5 and 20 %."""
    again = record("flashocc-87654321", 0.5, 0.4, {180: 0.4})
    short = [one._replace(training=f"1000 steps, seed {seed}") for seed, one in enumerate((OTHER, again))]
    long = OURS._replace(training="10000 steps, seed 0")
    elsewhere = OURS._replace(facts=OURS.facts | {"setting": "another"})
    first, others, last = page_parts([elsewhere, *short, long], "1000", {"flashocc": "FlashOcc"})
    assert last.title == "Trained for other numbers of steps on other test scenes"
    assert first.title == "Trained for 1000 steps"
    assert first.cells[0][1:] == ["FlashOcc"]
    assert [line[1] for line in first.cells[1]] == ["0.450", "12.5", "45.0", "28.7", "0.321"]
    assert others.cells[0][1:] == ["ours, 10,000 steps"]


def test_tests_of_runs_know_their_training_and_stand_in_its_order():
    runs = [
        FinishedRun(f"flashocc-0000000{number}", {"steps": steps, "seed": seed}, {})
        for number, (steps, seed) in enumerate([(10000, 1), (1000, 0), (10000, 0)])
    ]
    tests = [record(name, 0.5, 0.4, {}) for name in ["tiny", *(run.name for run in runs)]]
    assert [(test.system, test.training) for test in with_training(tests, runs)] == [
        ("flashocc-00000001", "1000 steps, seed 0"),
        ("flashocc-00000002", "10000 steps, seed 0"),
        ("flashocc-00000000", "10000 steps, seed 1"),
        ("tiny", ""),
    ]


def test_a_part_without_a_score_is_a_dash():
    blind = OURS.parts[1]._replace(scores={"rayiou": math.nan}, without={"rayiou": [math.nan] * 3})
    rows = part_cells([OURS._replace(parts=[OURS.parts[0], blind])])[1]
    assert rows[0][1].startswith("–")


def test_the_plot_has_a_bar_for_every_system_and_disturbance():
    pytest.importorskip("matplotlib")
    from omniocc.report.plots import drops

    axes = drops([OURS, OTHER]).axes[0]
    assert [label.get_text() for label in axes.get_yticklabels()] == ["noise_5_percent", "view_180_deg", "view_90_deg"]
    assert [bar.get_width() for bar in axes.patches] == pytest.approx([0.05, 0.2, 0.3, 0.02, 0.28])
