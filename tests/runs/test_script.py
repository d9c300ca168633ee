"""The command line of scripts: help that is cut off, and Python 3.14, whose check older Pythons get here."""

import argparse
import subprocess
import sys
from pathlib import Path

import pytest
from hydra._internal.utils import get_args_parser

from omniocc.runs.script import accept_lazy_help

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


@pytest.mark.parametrize("words", [("record.py", "--help"), ("report.py", "--help")])
def test_output_may_be_cut_off_by_a_pager(words):
    command = [sys.executable, str(SRC / words[0]), *words[1:]]
    script = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    script.stdout.close()
    assert (script.stderr.read(), script.wait(60)) == ("", 0)
