"""The command line of scripts: help that is cut off, and Python 3.14, whose check older Pythons get here."""

import argparse
import errno
import subprocess
import sys
from pathlib import Path

import pytest
from hydra import compose, initialize_config_dir
from hydra._internal.utils import get_args_parser
from hydra.errors import HydraException
from scripts import run_script

from omniocc.runs.script import accept_lazy_help, explain, line_of, nearest

SRC = Path(__file__).parents[2] / "src"


@pytest.fixture
def checked_help(monkeypatch):
    """Have argparse look at every help text as it is added, as Python 3.14 does."""
    if hasattr(argparse.ArgumentParser, "_check_help"):
        return
    add_argument = argparse.ArgumentParser.add_argument

    def check(parser, action):
        try:
            if action.help and "%" in action.help:
                parser._get_formatter()._expand_help(action)
        except (ValueError, TypeError, KeyError) as error:
            raise ValueError("badly formed help string") from error

    def add_and_check(parser, *args, **kwargs):
        action = add_argument(parser, *args, **kwargs)
        if isinstance(parser, argparse.ArgumentParser):
            parser._check_help(action)
        return action

    monkeypatch.setattr(argparse.ArgumentParser, "_check_help", check, raising=False)
    monkeypatch.setattr(argparse._ActionsContainer, "add_argument", add_and_check)


@pytest.mark.usefixtures("checked_help")
def test_hydra_alone_does_not_start():
    """When this fails, Hydra has mended it and `accept_lazy_help` can go."""
    with pytest.raises(ValueError, match="help string"):
        get_args_parser()


@pytest.mark.usefixtures("checked_help")
def test_hydra_starts_and_strings_are_checked_as_before():
    parser = accept_lazy_help(get_args_parser)()
    assert parser.parse_args(["--multirun", "seed=1,2"]).overrides == ["seed=1,2"]
    (completion,) = (action for action in parser._actions if action.dest == "shell_completion")
    assert "Install or Uninstall shell completion" in str(completion.help)

    def mistake():
        argparse.ArgumentParser().add_argument("--share", help="50 % of all")

    for wrapped in (mistake, accept_lazy_help(mistake)):
        with pytest.raises(ValueError, match="help string"):
            wrapped()


@pytest.mark.parametrize("words", [("record.py", "--help")])
def test_output_may_be_cut_off_by_a_pager(words):
    command = [sys.executable, str(SRC / words[0]), *words[1:]]
    script = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    script.stdout.close()
    assert (script.stderr.read(), script.wait(60)) == ("", 0)


ROOT = Path(__file__).parents[2]
CONF = str(ROOT / "conf")


def explained(*overrides: str) -> list[str]:
    with initialize_config_dir(CONF, version_base="1.3"), pytest.raises(HydraException) as caught:
        compose("train", list(overrides))
    return explain(caught.value, CONF, "train", overrides).splitlines()


@pytest.mark.parametrize(
    ("overrides", "problem", "offered"),
    [
        (["model.channelz=3"], "model.channelz: there is no such key", "model.lifter.channels"),
        (["n_jobs=0"], "n_jobs: there is no such key", "hydra.launcher.n_jobs"),
        (["stages.depth.max_step=3"], "stages.depth.max_step: there is no such key", "stages.depth.max_steps"),
        (["trainer.max_steps=3"], "trainer.max_steps: it is stages.occupancy.max_steps now", ""),
        (
            ["stages.occupancy.optimizer.learning_rate=1"],
            "of the last stage is the group optimizer",
            "optimizer.learning_rate",
        ),
        (["trainer.max_epochs=3"], "trainer.max_epochs: it is stages.occupancy.max_epochs now", ""),
        (
            ["trainer.detect_anomaly=true"],
            "trainer.detect_anomaly: there is no such key",
            "a plus: +trainer.detect_anomaly=",
        ),
        (["model.lifter.qqqqqq=3"], "model.lifter.qqqqqq: there is no such key", "model.lifter: geometry, channels"),
        (["preset.lifter.coloring.layers=2"], "preset.lifter: there is no such key", "own key: model.lifter.layers="),
        (["model/skecth=omni"], "model/skecth: there is no such key", "model/sketch"),
        (["sketch=omni"], "sketch: there is no such key", "model/sketch"),
        (
            ["model/sketch=onmi"],
            "model/sketch=onmi: there is no such option; did you mean 'omni'?",
            "dense, mono, omni",
        ),
        (["+ablation=oours"], "ablation=oours: there is no such option; did you mean 'ours'?", "bevdet, bevformer"),
        (["preset=huge"], "preset=huge: there is no such option", "paper, small, smoke, tiny"),
        (["ablation=mono"], "ablation", "+ablation=mono"),
        (["seed=[1"], "seed=[1: this cannot be read as key=value", "key=[1,2]"),
        (["seed"], "seed: this cannot be read as key=value", "key=[1,2]"),
        (["seed=1,2"], "'seed=1,2'", "--multirun"),
        (["hydra.job.chdir=abc"], "hydra.job.chdir=abc", "not a valid bool"),
    ],
)
def test_the_first_line_is_the_problem_and_the_nearest_key_follows(overrides, problem, offered):
    lines = explained(*overrides)
    assert problem in lines[0]
    assert offered in "\n".join(lines)
    assert len(lines) <= 4
    assert "struct" not in "\n".join(lines)


def test_keys_are_those_of_the_options_chosen_beside_the_mistake():
    assert "model.sketch.fraction" in explained("model/sketch=random", "model.sketch.fractoin=0.1")[0]
    assert "model.sketch.threshold" in explained("model.sketch.threshhold=0.1", "nonsense=2")[0]


def test_a_name_that_is_a_key_and_a_group_is_offered_once():
    assert explained("presett=tiny")[0].split().count("preset") == 1


def test_nearest_names_come_best_first_and_far_ones_not_at_all():
    assert nearest("sed", ["data.seed", "seed", "model.lifter"]) == ["seed", "data.seed"]
    assert nearest("zzz", ["seed"]) == []


@pytest.mark.parametrize(
    ("command", "first"),
    [
        (("train.py", "--multirun", "seed=0,1", "model.channelz=3"), "model.channelz: "),
        (("train.py", "--multirun", "hydra.launcher.n_jobs=0"), "hydra.launcher: n_jobs=0"),
        (("train.py", "--cfg", "job", "model/sketch=onmi"), "model/sketch=onmi: "),
        (("train.py", "--help", "model/sketch=onmi"), "model/sketch=onmi: "),
        (("render.py", "scene=2"), "scene: there is no such key; did you mean scenes"),
        (("export.py", "rigg=x"), "rigg: there is no such key; did you mean rig"),
        (("predict.py", "depth", "rigg=x"), "rigg: there is no such key; did you mean rig"),
        (("predict.py", "occupancy", "rig=[x"), "rig=[x: this cannot be read"),
    ],
)
def test_every_script_says_it_without_a_traceback(command, first, tmp_path):
    result = run_script(*command)
    assert result.returncode == 1
    assert result.stderr.startswith(first)
    assert len(result.stderr.splitlines()) <= 4


def test_a_disk_that_a_library_finds_full_or_read_only_has_a_remedy(tmp_path):
    full = OSError(errno.ENOSPC, "No space left on device", str(tmp_path / "csv"))
    assert line_of(full).startswith(f"cannot write {tmp_path / 'csv'}: the disk is full: free some space, then")
    missing = FileNotFoundError(errno.ENOENT, "No such file", "csv")
    assert line_of(missing) == str(missing)
