"""The folder of a run, whose name is derived from the configuration, so that the same command finds it again."""

import hashlib
import json
import os
import shlex
import subprocess
import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from filelock import FileLock

from omniocc.config import CONF, PACKAGES, PACKAGES_VARIABLE
from omniocc.data.store.shard import sha256
from omniocc.errors import UserError
from omniocc.io import atomic_write, checked_name
from omniocc.lock import Held, acquire
from omniocc.runs.checkpoint_io import LAST, no_checkpoint_message, resumable
from omniocc.runs.distributed import broadcast, is_first, started_by_others
from omniocc.runs.results import METRICS, load_results
from omniocc.runs.slots import foreign_code, foreign_packages, sketch_learns
from omniocc.runs.weights import find_checkpoint

STARTED_FROM = "started_from.txt"
"""File with the checkpoint that `resume=` named, written when the run starts from it."""
PARTS = "parts"
"""Subfolder of `IMAGES`, of the parts of the sheets."""
PAGE = "view.html"
"""Page with frames to turn, in the folder of a run."""
VOLATILE = (
    "name",
    "resume",
    "weights",
    "stage",
    "paths",
    "packages",
    "logger",
    "test_images",
    "checkpoint_every_n_steps",
    "plan",
    "preset",
)
"""Root keys that do not change what a run computes; those that a recipe or a part refers to count there."""
WITHOUT_START = ("auto", "never")
"""Values of `resume` that name no checkpoint."""
LAST_STAGE = "occupancy"
OF_MACHINES = ("root", "cache", "workers", "num_workers", "accelerator", "log_every_n_steps", "enable_model_summary")
"""Keys at any depth that do not change what a run computes: where data lie, and how a machine reads and tells them."""
PACKAGE = Path(__file__).resolve().parents[1]
COMMANDS = PACKAGE / "commands"
DECIDING = (PACKAGES_VARIABLE, "OMNIOCC_PRESET")
"""Environment variables by which the same command composes another configuration."""
CHANGED, NO_COMMIT = "+", "unknown"
"""End of the commit of a source tree with changes, and what stands for a commit outside a repository."""
RANK_FOLDER = "OMNIOCC_RUN_FOLDER"
"""Environment variable with the folder, set by the first process of a distributed run for its children."""


@dataclass(frozen=True)
class RunFolder:
    """The folder of a run, its checkpoint and its lock.

    Attributes:
        path: the folder.
        checkpoint: file to resume from; None at the start, and when the run is finished.
        lock: held by the run's first process, None in the others.
    """

    path: Path
    checkpoint: Path | None
    lock: FileLock | None

    @property
    def finished(self) -> bool:
        """Return whether the run has been trained and tested."""
        return (self.path / METRICS).exists()


def run_hash(config: dict[str, Any], data_fingerprint: str) -> str:
    """Return eight hex digits of everything that decides a run's result, code of other packages included."""
    learns = sketch_learns(config)
    unused = () if learns else ("depth", "appearance")
    if config.get("occupied_above") is None:  # the hash of runs from before this key
        unused += ("occupied_above",)
    kept = without_machine({key: value for key, value in config.items() if key not in (*VOLATILE, *unused)})
    stages = config["stages"] if learns else (LAST_STAGE,)
    kept["stages"] = with_digests(config["stages"], stages)
    if (given := given_checkpoint(config.get("resume", "auto"))) is not None:  # another start gives another result
        kept["resume"] = sha256(given)
    return short_hash([kept, data_fingerprint, *foreign_code(kept)])


def run_folder(runs: Path, config: dict[str, Any], data_fingerprint: str) -> Path:
    """Return the folder of the run of a resolved configuration; those of `resume=never` have a number behind it."""
    return runs / f"{config['name']}-{run_hash(config, data_fingerprint)}"


def without_machine(tree: Any) -> Any:
    """Return plain data without the keys `OF_MACHINES`."""
    if isinstance(tree, dict):
        return {key: without_machine(value) for key, value in tree.items() if key not in OF_MACHINES}
    return [without_machine(value) for value in tree] if isinstance(tree, list) else tree


def with_digests(recipes: Mapping[str, Any], stages: Iterable[str]) -> dict[str, dict[str, Any]]:
    """Return the recipes of some stages, with the hash of the file of weights that each starts from, not its name.

    A file that is trained again under its name then gives another hash. Without such a file there is no `weights`.

    Raises:
        FileNotFoundError: naming the key, when there is no such file.
    """
    found: dict[str, dict[str, Any]] = {}
    for stage in stages:
        found[stage] = {key: value for key, value in recipes[stage].items() if key != "weights"}
        if (weights := recipes[stage].get("weights")) is not None:
            path = find_checkpoint(weights)
            if not path.is_file():
                raise FileNotFoundError(f"stages.{stage}.weights={weights}: {no_checkpoint_message(path)}")
            found[stage]["weights"] = sha256(path)
    return found


def short_hash(content: Any) -> str:
    """Return eight hex digits of plain data."""
    return hashlib.sha256(json.dumps(content, sort_keys=True, default=str).encode()).hexdigest()[:8]


def open_run(runs: Path, name: str, digest: str, resume: str) -> RunFolder:
    """Find or make the folder of a run and lock it.

    Args:
        runs: folder of all runs.
        name: readable part of the folder's name.
        digest: `run_hash` of the run.
        resume: `auto` continues the folder of the same hash; `never` makes a new one beside it; anything else is the
            checkpoint to start from. A run that was started so and stopped goes on from what it has saved since.

    Raises:
        UserError: when no folder can have the name, another process works in it, its checkpoints are damaged, or the
            processes of this run cannot agree on a new folder.
        FileNotFoundError: when there is no such checkpoint.
    """
    if resume == "never" and started_by_others():
        raise UserError(
            "resume=never: the processes that torchrun or Slurm starts cannot agree on a new folder; give this run "
            "another name=... instead"
        )
    path, lock = runs / f"{checked_name('name', name)}-{digest}", None
    if is_first():
        path, lock = _claim(path, fresh=resume == "never")
        os.environ[RANK_FOLDER] = str(path)
    else:
        path = Path(os.environ.get(RANK_FOLDER, path))
    path = Path(broadcast(str(path)))
    path.mkdir(parents=True, exist_ok=True)
    given = given_checkpoint(resume)
    if (path / METRICS).exists():
        return RunFolder(path, None, lock)
    start = path / LAST
    if given is not None and not _has_gone_on_from(path, given):
        start = given
        if lock is not None:
            atomic_write(path / STARTED_FROM, str(given.resolve()))
    checkpoint, message = resumable(start)
    if message and lock is not None:
        print(message, flush=True)
    return RunFolder(path, checkpoint, lock)


def _has_gone_on_from(path: Path, given: Path) -> bool:
    """Return whether the run in this folder was started from the checkpoint `given` and has saved one since."""
    started, saved = path / STARTED_FROM, path / LAST
    if not (started.is_file() and saved.is_file()):
        return False
    same = started.read_text("utf-8") == str(given.resolve())
    return same and saved.stat().st_mtime_ns > started.stat().st_mtime_ns


def given_checkpoint(resume: str) -> Path | None:
    """Return the checkpoint that `resume` names, if it names one; raise FileNotFoundError when missing."""
    if resume in WITHOUT_START:
        return None
    if not Path(resume).is_file():
        raise FileNotFoundError(f"resume={resume}: there is no such checkpoint; auto goes on where this run was")
    return Path(resume)


def _claim(path: Path, fresh: bool) -> tuple[Path, FileLock]:
    number, candidate = 2, path
    while fresh and candidate.exists():
        number, candidate = number + 1, path.with_name(f"{path.name}-{number}")
    try:
        return candidate, acquire(candidate / ".lock")
    except Held as held:
        raise UserError(
            f"another process is working in {candidate}; wait for it, or give this run another name=...{held.remedy}"
        ) from None


def command_line() -> str:
    """Return the command that started this process, with paths relative to the working folder.

    Environment variables that decide what it composes stand before it.
    """
    script, *arguments = sys.argv
    path = Path(script)
    if path.resolve().parent == COMMANDS:
        return " ".join([*_assigned(os.environ), shlex.join(["omniocc", path.stem, *arguments])])
    if path.is_absolute() and path.is_relative_to(Path.cwd()):
        script = str(path.relative_to(Path.cwd()))
    return " ".join([*_assigned(os.environ), shlex.join(["python", script, *arguments])])


def command_of(facts: Mapping[str, Any], config: Mapping[str, Any]) -> str | None:
    """Return the recorded command of a run with the packages that it needs; None if it was not recorded."""
    command = facts.get("command")
    given = [*PACKAGES, *(config.get("packages") or ())]
    if command is None or f"{PACKAGES_VARIABLE}=" in str(command) or not (own := foreign_packages(config, given)):
        return command
    return " ".join([*_assigned({PACKAGES_VARIABLE: ",".join(own)}), str(command)])


def _assigned(environment: Mapping[str, str]) -> list[str]:
    return [f"{name}={shlex.quote(environment[name])}" for name in DECIDING if environment.get(name)]


def git_commit() -> str:
    """Return the commit of the source tree, with `+` if files changed or are new; `unknown` of an installed package."""
    if CONF.is_relative_to(PACKAGE):  # a repository around it is another one
        return NO_COMMIT
    try:
        commit = _git("describe", "--always", f"--dirty={CHANGED}")
        new = _git("ls-files", "--others", "--exclude-standard", "--", str(PACKAGE.parent), str(CONF))
    except (OSError, subprocess.CalledProcessError):
        return NO_COMMIT
    return commit.removesuffix(CHANGED) + CHANGED if new else commit


def _git(*words: str) -> str:
    return subprocess.run(["git", *words], cwd=PACKAGE, capture_output=True, text=True, check=True).stdout.strip()


def made_by_other_code(folder: Path) -> str:
    """Return a phrase that names the commit that trained a finished run; empty if it is that of this code."""
    trained, own = load_results(folder)[0].get("commit", NO_COMMIT), git_commit()
    return "" if trained == own else f" (trained by the code of commit {trained}; this is {own})"


def is_clean(commit: str | None) -> bool:
    """Return whether the code of a run is that of a commit: known, and without changes."""
    return commit not in (None, NO_COMMIT) and not str(commit).endswith(CHANGED)
