"""The learning rate of each system, chosen among equally many tries."""

import csv
import math

import pytest

from omniocc.report.runs import FinishedRun
from omniocc.report.tables.learning_rates import common_name, learning_rates_csv, tuned_systems

SCORE = "validation voxel RayIoU"


def run(name: str, rate: float, seed: int, score: float, layers: int = 1, data: str = "d") -> FinishedRun:
    stages = {"occupancy": {"learning_rate": rate}}
    config = {"name": name, "seed": seed, "model": {"layers": layers}, "optimizer": {"learning_rate": rate}}
    config |= {"preset": {"stages": stages}}
    metrics = {"val/rayiou": score, "test/rayiou": 1 - score}
    return FinishedRun(f"{name}-{seed:08x}", {"seed": seed, "data": data}, metrics, config=config)


RUNS = [
    run("ours_001", 0.001, 0, 0.30),
    run("ours_003", 0.003, 0, 0.36),
    run("ours_01", 0.01, 0, 0.35),
    run("ours", 0.003, 1, 0.10),  # no other rate has this seed
    run("bevdet_001", 0.001, 0, 0.10, layers=2),
    run("bevdet_01", 0.01, 0, 0.20, layers=2),
    run("mono", 0.003, 0, 0.26, layers=3),  # one rate
    run("ours_far_003", 0.003, 0, 0.2, data="e"),
    run("ours_far_01", 0.01, 0, 0.2, data="e"),
]


def test_systems_are_told_by_everything_but_the_rate():
    found = {tried.name: tried for tried in tuned_systems(RUNS)}
    assert list(found) == ["bevdet", "ours", "ours_far"]
    assert {rate: [run.name for run in runs] for rate, runs in found["ours"].runs.items()} == {
        0.001: ["ours_001-00000000"],
        0.003: ["ours_003-00000000"],
        0.01: ["ours_01-00000000"],
    }
    rates = {name: system.best_rate for name, system in found.items()}
    assert rates == {"bevdet": 0.01, "ours": 0.003, "ours_far": 0.003}


def test_a_later_key_that_is_null_tells_no_runs_apart_and_one_that_is_set_does():
    unknown = [run("mono_001", 0.001, 0, math.nan, layers=4), run("mono_01", 0.01, 0, math.nan, layers=4)]
    assert tuned_systems(unknown) == []
    later = [run("ours_01", 0.01, 0, 0.35), run("ours_01", 0.01, 0, 0.35)]
    for member, value in zip(later, (None, 2), strict=True):
        member.config["model"]["heads"] = value
    assert [[*tried.runs] for tried in tuned_systems([*RUNS[:2], later[0]])] == [[0.001, 0.003, 0.01]]
    assert [[*tried.runs] for tried in tuned_systems([*RUNS[:2], later[1]])] == [[0.001, 0.003]]


def test_two_seeds_are_averaged_if_all_rates_have_them():
    second = [run("ours_001", 0.001, 1, 0.50), run("ours_003", 0.003, 1, 0.40)]
    (tried,) = tuned_systems([*RUNS[:2], *second])
    assert tried.best_rate == 0.001
    first, other = told([*RUNS[:2], *second])
    assert (first["learning rate"], first[f"{SCORE}, mean"], first["seeds"], first["chosen"]) == (
        "0.001",
        "0.4",
        "2",
        "yes",
    )
    assert (other[f"{SCORE}, standard error"], other["chosen"]) == ("0.02", "no")


def test_the_file_has_validation_scores_alone():
    lines = told(RUNS)
    assert [line[f"{SCORE}, mean"] for line in lines if line["system"] == "ours"] == ["0.3", "0.36", "0.35"]
    assert [line["learning rate"] for line in lines if line["chosen"] == "yes"] == ["0.01", "0.003", "0.003"]
    assert "0.64" not in learning_rates_csv(RUNS)
    assert learning_rates_csv(RUNS[-3:-2]) == ""


def told(runs: list[FinishedRun]) -> list[dict[str, str]]:
    return list(csv.DictReader(learning_rates_csv(runs).splitlines()))


@pytest.mark.parametrize(
    ("rows", "name"),
    [
        (["ours_001", "ours_003", "ours"], "ours"),
        (["bevdet_ranges_001", "bevdet_ranges_01"], "bevdet_ranges"),
        (["a", "b"], "a"),
    ],
)
def test_names(rows, name):
    assert common_name(rows) == name
