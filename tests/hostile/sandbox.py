"""Open hostile files by the commands, each in a process of its own, and say what a command must not have done.

A case has a folder to itself. A command works in `work`, may write below `work/out` alone, and finds its input in
`given`, which other things surround: a home, a folder for temporary files and a neighbour's files. Code that runs from
a file leaves something in `marks`.
"""

import os
import random
import re
import stat
import subprocess
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from scripts import run_script

SECRET = "a-secret-of-the-environment"
"""Value of a variable that no file may make a command print."""
TIMEOUT_S = 30.0
"""Several times what the slowest command takes; more on a machine whose processes wait for one another."""
MEMORY_BYTES = 3 * 2**30
LONGEST_MESSAGE = 4000
"""Characters on stderr above which an error is no longer one clear error."""
LAST_LINES = 6


@dataclass(frozen=True)
class Opening:
    """A command that opens a file.

    Attributes:
        command: script and its arguments.
        expect: `refused`: it must end with an error; `right`: it must succeed; `either`.
        names: texts of which the error must hold one; empty: the base names of the file.
        check: returns what is wrong with the result of a success, given the folder of output and what was printed.
        stop_when: returns true when a command that does not end by itself may be stopped.
        found: what that function found to be wrong.
    """

    command: tuple[str, ...]
    expect: str = "refused"
    names: tuple[str, ...] = ()
    check: Callable[[Path, str], str | None] | None = None
    stop_when: Callable[[], bool] | None = None
    found: Sequence[str] = ()


class Case(NamedTuple):
    """A hostile file, or folder of files.

    Attributes:
        kind: of file, in the plural.
        name: tells the mutation.
        make: writes it into a box and returns the openings.
    """

    kind: str
    name: str
    make: Callable[["Box"], Sequence[Opening]]


class Box:
    """The folders of a case."""

    def __init__(self, folder: Path, base: Path, shared: Path):
        self.folder, self.base, self.shared = folder, base, shared
        self.given, self.work, self.marks = folder / "given", folder / "work", folder / "marks"
        self.out = self.work / "out"
        self.home, self.temporary, self.neighbour = folder / "home", folder / "tmp", folder / "neighbour"
        for made in (self.given, self.out, self.marks, self.home, self.temporary, self.neighbour):
            made.mkdir(parents=True)
        (self.neighbour / "notes.txt").write_text("not of this folder")

    def snapshot(self) -> dict[str, tuple[int, ...]]:
        """Return size and time of change of every file but those of the output."""
        found = {}
        for folder, names, files in os.walk(self.folder):
            place = Path(folder)
            if place == self.out:
                names.clear()
                continue
            for name in (*names, *files):
                state = (place / name).lstat()
                is_folder = stat.S_ISDIR(state.st_mode)
                found[str((place / name).relative_to(self.folder))] = (
                    stat.S_IFMT(state.st_mode),
                    *(() if is_folder else (state.st_size, state.st_mtime_ns)),
                )
        return found

    def run(self, opening: Opening, timeout_s: float) -> "subprocess.CompletedProcess[str]":
        """Run a command with this box as its surroundings."""
        script, *arguments = opening.command
        variables = {
            "HOME": self.home,
            "TMPDIR": self.temporary,
            "XDG_CACHE_HOME": self.home / "cache",
            "MPLCONFIGDIR": self.shared,
            "TORCHINDUCTOR_CACHE_DIR": self.shared,
            "PYTHONPATH": self.work,
            "HOSTILE_SECRET": SECRET,
            "OMNIOCC_PACKAGES": "",
            "WANDB_MODE": "disabled",
            "HF_HUB_OFFLINE": "1",
        }
        return run_script(
            script,
            *arguments,
            cwd=self.work,
            timeout_s=timeout_s,
            memory_bytes=MEMORY_BYTES,
            kill_when=opening.stop_when or (lambda: False),
            **{key: str(value) for key, value in variables.items()},
        )

    def problems(self, opening: Opening) -> list[str]:
        """Run a command and return what it did that it must not do; an empty list if it behaved."""
        for old in self.out.iterdir():
            subprocess.run(["rm", "-rf", str(old)], check=True)
        before, timeout_s = self.snapshot(), TIMEOUT_S * max(1.0, os.getloadavg()[0] / (os.cpu_count() or 1))
        try:
            done = self.run(opening, timeout_s)
        except subprocess.TimeoutExpired:
            return [f"hangs: it has not ended after {timeout_s:.0f} s", *self._traces(before)]
        return [*self._traces(before), *_of_end(done, opening, self.out)]

    def _traces(self, before: dict[str, tuple[int, ...]]) -> Iterable[str]:
        after = self.snapshot()
        changed = sorted(path for path in before.keys() | after.keys() if before.get(path) != after.get(path))
        ran = [path for path in changed if path.startswith(f"{self.marks.name}/")]
        if ran:
            yield f"RUNS CODE: {', '.join(ran[:3])}"
        if outside := [path for path in changed if path not in ran]:
            yield f"changes files outside its output: {', '.join(outside[:3])}"


def _of_end(done: "subprocess.CompletedProcess[str]", opening: Opening, out: Path) -> Iterable[str]:
    """Yield what is wrong with exit code, messages and result of a command that has ended."""
    text = done.stdout + done.stderr
    if SECRET in text:
        yield "prints a variable of the environment"
    if "Traceback (most recent call last)" in text:
        yield f"traceback: {raised(text)}"
        return
    yield from opening.found
    if done.returncode < 0:
        if opening.stop_when is None:
            yield f"killed by signal {-done.returncode}: {last_line(text)}"
    elif done.returncode:
        if not any(name in text for name in opening.names):
            yield f"its error names none of {', '.join(opening.names)}: {last_line(text)}"
        if opening.expect == "right":
            yield f"refuses a file that is right: {last_line(text)}"
        if len(done.stderr) > LONGEST_MESSAGE:
            yield f"its error has {len(done.stderr):,} characters: {done.stderr[:200]!r}"
    elif opening.expect == "refused":
        yield f"accepts it: {last_line(text)}"
    elif opening.check is not None and (wrong := opening.check(out, text)):
        yield f"succeeds with a wrong result: {wrong}"


def some(openings: Sequence[Opening], count: int, rng: random.Random) -> list[Opening]:
    """Return some of the openings; those that must refuse the file first."""
    return sorted(rng.sample(list(openings), len(openings)), key=lambda one: one.expect == "either")[:count]


def raised(text: str) -> str:
    """Return the line that names the exception of the last traceback."""
    lines = re.findall(r"^\w[\w.]*(?:Error|Exception|Interrupt|Iteration|\.error)\b.*", text, re.MULTILINE)
    return lines[-1][:300] if lines else last_line(text)


def last_line(text: str) -> str:
    """Return the last line that says something, shortened."""
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    return (lines[-1] if lines else "nothing was printed")[:300]
