"""Figures of later tests of a run."""

import json
import re
import subprocess
from functools import partial

import pytest

from omniocc.errors import UserError
from omniocc.runs.folder import git_commit, made_by_other_code
from omniocc.runs.results import (
    FROM_TRAJECTORY,
    OVERRIDES,
    load_results,
    save_results,
    trajectory_figures,
)

METRICS = {"test/rayiou": 0.2, "test/rayiou_past": 0.25, "test/rayiou_now": 0.3, "prior/rayiou": 0.1}


def test_scores_by_origin_are_those_of_the_later_test(tmp_path):
    assert trajectory_figures(tmp_path, "abc") == {}
    save_results(tmp_path / FROM_TRAJECTORY, METRICS, {"data": "abc", OVERRIDES: []})
    assert trajectory_figures(tmp_path, "abc") == {
        "test/trajectory/rayiou": 0.2,
        "test/trajectory/rayiou_past": 0.25,
        "test/trajectory/rayiou_now": 0.3,
    }


@pytest.mark.parametrize(
    "facts",
    [{"data": "other", OVERRIDES: []}, {"data": "abc", OVERRIDES: ["model.sketch.threshold=0.5"]}, {"data": "abc"}],
)
def test_a_test_of_another_model_or_on_other_data_does_not_count(tmp_path, facts):
    save_results(tmp_path / FROM_TRAJECTORY, METRICS, facts)
    assert trajectory_figures(tmp_path, "abc") == {}


def test_a_run_of_another_commit_is_named(tmp_path):
    save_results(tmp_path, {"test/rayiou": 0.5}, {"commit": git_commit()})
    assert made_by_other_code(tmp_path) == ""
    save_results(tmp_path, {"test/rayiou": 0.5}, {"commit": "abc1234"})
    assert made_by_other_code(tmp_path) == f" (trained by the code of commit abc1234; this is {git_commit()})"


@pytest.mark.parametrize(
    ("score", "said"),
    [(10**400, "test/rayiou is 1000"), (float("inf"), "test/rayiou is inf"), (1e300, "test/rayiou is 1e")],
)
def test_a_score_that_no_float_holds_is_refused(score, said, tmp_path):
    (tmp_path / "metrics.json").write_text(json.dumps({"metrics": {"test/rayiou": score}}))
    with pytest.raises(UserError, match=rf"metrics\.json is damaged \({said}"):
        load_results(tmp_path)


@pytest.mark.parametrize(
    ("fact", "value"),
    [
        ("seed", {"a": 1}),
        ("seed", "1"),
        ("minutes of training", "a"),
        ("minutes of training", 10**400),
        ("protocol", "rays"),
        ("protocol", {"rayiou": "<script>"}),
        ("classes", [1]),
        ("preset", 3),
    ],
)
def test_facts_of_other_types_are_refused(fact, value, tmp_path):
    (tmp_path / "metrics.json").write_text(json.dumps({"metrics": {"test/rayiou": 0.5}, "seed": 1, fact: value}))
    with pytest.raises(UserError, match=rf"metrics\.json is damaged \(.*{fact}"):
        load_results(tmp_path)


def test_a_part_that_is_not_committed_yet_counts_as_a_change(tmp_path, monkeypatch):
    package, conf = tmp_path / "src" / "omniocc", tmp_path / "conf"
    for folder in (package, conf):
        folder.mkdir(parents=True)
        (folder / "known").touch()
    run = partial(subprocess.run, cwd=tmp_path, check=True, capture_output=True)
    run(["git", "init", "--quiet"])
    run(["git", "add", "."])
    run(["git", "-c", "user.name=a", "-c", "user.email=a@b.c", "commit", "--quiet", "-m", "first"])
    monkeypatch.setattr("omniocc.runs.folder.PACKAGE", package)
    monkeypatch.setattr("omniocc.runs.folder.CONF", conf)
    clean = git_commit()
    assert re.fullmatch("[0-9a-f]+", clean)
    (tmp_path / "notes").touch()
    assert git_commit() == clean
    (package / "gate.py").touch()
    assert git_commit() == f"{clean}+"
    (package / "known").write_text("changed")
    assert git_commit() == f"{clean}+"
