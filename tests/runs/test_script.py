"""The command line of scripts: help that is cut off, and Python 3.14, whose check older Pythons get here."""

import argparse
import errno
import math
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from hydra import compose, initialize_config_dir
from hydra._internal.utils import get_args_parser
from hydra.errors import HydraException
from scripts import run_script

from omniocc.errors import UserError
from omniocc.runs.results import save_results
from omniocc.runs.script import accept_lazy_help, explain, line_of, lines_not_tracebacks, nearest, read_overrides

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
        (("predict.py", "depth"), "images=... is needed; see python src/predict.py depth --help"),
        (("predict.py", "occupancy"), "checkpoint=... is needed; see python src/predict.py occupancy --help"),
        (
            ("check.py", "data=recorded", "data.source.roo=x"),
            "data.source.roo: there is no such key; did you mean data.s",
        ),
        (("adapt.py", "minuts=9"), "minuts: there is no such key; did you mean minutes?"),
        (("adapt.py", "model/backbon=x", "data=recorded"), "model/backbon: there is no such key; did you mean model/b"),
        (("predict.py", "depth", "rigg=x"), "rigg: there is no such key; did you mean rig"),
        (("predict.py", "occupancy", "rig=[x"), "rig=[x: this cannot be read"),
    ],
)
def test_every_script_says_it_without_a_traceback(command, first, tmp_path):
    result = run_script(*command)
    assert result.returncode == 1
    assert result.stderr.startswith(first)
    assert len(result.stderr.splitlines()) <= 4


ASCII = {"PYTHONIOENCODING": "", "LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
"""Environment of a terminal without UTF-8."""
SHOWN = """
import sys
from pathlib import Path
from omniocc.runs.results import show_results
from omniocc.runs.script import lines_not_tracebacks
from omniocc.errors import UserError

@lines_not_tracebacks
def main():
    show_results(Path(sys.argv[1]))
    print("0.5 ± 0.1 … 3 × µ á ✅ 東")
    raise UserError("α – β")

main()
"""


@pytest.mark.parametrize(
    ("environment", "last", "error"),
    [
        ({**ASCII, "PYTHONIOENCODING": "ascii"}, "0.5 +/- 0.1 ... 3 x u a yes ?", "? - ?"),
        ({**ASCII, "PYTHONIOENCODING": "latin-1"}, "0.5 ± 0.1 ... 3 × µ á yes ?", "? - ?"),
        (ASCII, "0.5 +/- 0.1 ... 3 x u a yes ?", "? - ?"),
    ],
    ids=lambda value: value.get("PYTHONIOENCODING") or "locale" if isinstance(value, dict) else None,
)
def test_a_terminal_of_any_encoding_shows_the_results(environment, last, error, tmp_path):
    folder = tmp_path / "ärger"
    folder.mkdir()
    save_results(folder, {"test/rayiou": 0.25, "test/rayiou/car": math.nan, "prior/rayiou": 0.125}, {"run": "é – ü"})
    (script := tmp_path / "script.py").write_text(SHOWN, "utf-8")
    variables = {**os.environ, "PYTHONPATH": str(SRC), **environment}
    result = subprocess.run([sys.executable, script, folder], env=variables, capture_output=True, check=False)
    encoding = environment["PYTHONIOENCODING"] or "ascii"
    printed = result.stdout.decode(encoding, "replace")  # bytes of file names come out as they are
    assert (printed.splitlines()[-1], result.returncode) == (last, 1)
    assert result.stderr.decode(encoding).strip() == error
    assert "0.250" in printed
    assert "é – ü" in (folder / "table.md").read_text("utf-8")


READS = """
import os, signal, socket, time
from multiprocessing.resource_sharer import DupFd
from pathlib import Path
import torch
from torch.utils.data import Dataset, default_collate
from omniocc.data.loader import Loader
from omniocc.runs.script import lines_not_tracebacks, quiet_libraries

class Slow(Dataset):
    def __len__(self):
        return 1000

    def __getitem__(self, index):
        Path(f"{index}.read").touch()
        if DIES and index == 3:
            os.kill(os.getpid(), signal.SIGKILL)
        time.sleep(0.05)
        return torch.ones(32)

def hang_up(handle):
    with socket.socket(socket.AF_UNIX) as connection:
        connection.connect(handle._id[0])
    time.sleep(0.5)
    raise KeyboardInterrupt

@lines_not_tracebacks
def main():
    loader = Loader(Slow(), 1, 2, default_collate)
    if HANGS_UP:
        DupFd.detach = hang_up
    if not IN_LIGHTNING:
        return list(loader)
    from lightning.pytorch import Trainer
    from lightning.pytorch.demos.boring_classes import BoringModel

    quiet_libraries()
    quiet = {"logger": False, "enable_progress_bar": False, "enable_model_summary": False, "accelerator": "cpu"}
    Trainer(enable_checkpointing=False, **quiet).test(BoringModel(), loader, verbose=False)

if __name__ == "__main__":
    main()
"""


def reader(
    folder: Path, dies: bool = False, in_lightning: bool = False, hangs_up: bool = False
) -> subprocess.Popen[str]:
    """Start a script in a folder that reads by two processes, as the leader of a process group."""
    (folder / "reads.py").write_text(f"DIES, IN_LIGHTNING, HANGS_UP = {dies}, {in_lightning}, {hangs_up}\n{READS}")
    return subprocess.Popen(
        [sys.executable, "reads.py"],
        cwd=folder,
        env=os.environ | {"PYTHONPATH": str(SRC), "OMP_NUM_THREADS": "1"},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        # a test run started in the background of a shell ignores Ctrl-C, and children inherit this
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )


@pytest.mark.whole_runs
def test_the_death_of_a_loader_process_is_one_line(tmp_path):
    output, errors = (process := reader(tmp_path, dies=True)).communicate(timeout=120)
    assert (process.returncode, output) == (1, "")
    assert errors.startswith("data.num_workers=2: a loader process ended (out of memory?). Run the same command again")
    assert len(errors.splitlines()) == 1


def started_reader(folder: Path, in_lightning: bool) -> subprocess.Popen[str]:
    """Start a reader and return when its processes have read some samples."""
    process, deadline_s = reader(folder, in_lightning=in_lightning), time.monotonic() + 120
    while not (folder / "4.read").exists():
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < deadline_s
        time.sleep(0.02)
    return process


@pytest.mark.whole_runs
def test_processes_that_read_end_with_a_training_that_is_killed(tmp_path):
    process = started_reader(tmp_path, in_lightning=False)
    process.kill()
    process.communicate(timeout=60)  # returns when no process has the other ends of the pipes


@pytest.mark.whole_runs
def test_ctrl_c_of_a_terminal_is_one_line(tmp_path):
    """A terminal sends it to the whole group, also to the processes that read."""
    process = started_reader(tmp_path, in_lightning=True)
    os.killpg(process.pid, signal.SIGINT)
    assert process.communicate(timeout=60) == ("", "stopped by Ctrl-C\n")
    assert process.returncode == 130


@pytest.mark.whole_runs
def test_ctrl_c_while_a_batch_is_handed_over_is_one_line(tmp_path):
    output, errors = reader(tmp_path, hangs_up=True).communicate(timeout=120)
    assert (output, errors) == ("", "stopped by Ctrl-C\n")


def test_ctrl_c_while_a_script_imports_is_a_line(tmp_path):
    process = subprocess.Popen(
        [sys.executable, "-X", "importtime", str(SRC / "view.py")],
        cwd=tmp_path,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )
    assert process.stderr is not None
    for line in process.stderr:
        if line.split()[-1] == "omniocc":
            process.send_signal(signal.SIGINT)
            break
    errors = [line for line in process.stderr.read().splitlines() if not line.startswith("import time:")]
    assert errors == ["stopped by Ctrl-C"]
    assert process.wait(timeout=60) == -signal.SIGINT


def test_ctrl_c_says_what_the_same_command_does(capsys):
    def interrupted():
        raise KeyboardInterrupt

    before = signal.getsignal(signal.SIGINT)
    try:
        for main in (lines_not_tracebacks(interrupted, "it goes on"), interrupted):
            main = lines_not_tracebacks(main)  # as a script's main is, with one around Hydra
            with pytest.raises(SystemExit) as ended:
                main()
            assert ended.value.code == 130
    finally:
        signal.signal(signal.SIGINT, before)
    assert capsys.readouterr().err == "stopped by Ctrl-C; it goes on\nstopped by Ctrl-C\n"


def test_other_errors_of_the_code_keep_their_traceback():
    def wrong():
        raise RuntimeError("CUDA error")

    with pytest.raises(RuntimeError, match="CUDA"):
        lines_not_tracebacks(wrong)()


def test_a_disk_that_a_library_finds_full_or_read_only_has_a_remedy(tmp_path):
    full = OSError(errno.ENOSPC, "No space left on device", str(tmp_path / "csv"))
    assert line_of(full).startswith(f"cannot write {tmp_path / 'csv'}: the disk is full: free some space, then")
    missing = FileNotFoundError(errno.ENOENT, "No such file", "csv")
    assert line_of(missing) == str(missing)


def test_overrides_are_read_as_on_the_command_line():
    words = ["data.source.splits={train:1,val:0}", "data.source.root=/data of mine/a_b-c.d", "a.b=[1,2]", "a.c=null"]
    assert read_overrides(words) == {
        "data.source.splits": {"train": 1, "val": 0},
        "data.source.root": "/data of mine/a_b-c.d",
        "a.b": [1, 2],
        "a.c": None,
    }


@pytest.mark.parametrize(
    ("word", "message"), [("a=[1", r"a=\[1: this cannot be read as key=value"), ("a=1,2", "a=1,2: one value is needed")]
)
def test_an_override_that_cannot_be_read_is_named(word, message):
    with pytest.raises(UserError, match=message):
        read_overrides([word])
