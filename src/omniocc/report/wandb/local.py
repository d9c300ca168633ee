"""All W&B runs of this machine in a terminal: `python -m omniocc.report.wandb.local [--runs runs]`.

`make dashboard-local` calls it. `wandb leet`, which comes with W&B, opens one folder of runs, while ours lie in the
folders of the runs and stages. So a folder of links to all of them is made, and kept current at every start.
"""

import argparse
import os
import subprocess
import sys
from pathlib import Path

from omniocc.errors import UserError
from omniocc.runs.script import lines_not_tracebacks

WRITTEN = "wandb/*run-*/run-*.wandb"
"""Files of runs, offline or online ones."""
LINKS = "leet"
"""Folder of the links, in the folder of runs."""


def links_of(runs: Path) -> dict[Path, Path]:
    """Return where each file of a run, and the folder of its images, is to be linked, below `runs/leet`.

    The viewer lists the names of folders, `run-<time of the start>-<name of the run>`, newest first. In one it looks
    for `run-<name of the run>.wandb` and `files`.
    """
    found = {}
    for path in sorted(runs.glob(f"**/{WRITTEN}")):
        name, start = path.parents[2].name, path.parent.name.partition("run-")[2].partition("-")[0]
        folder = runs / LINKS / f"run-{start}-{name}"
        found[folder / f"run-{name}.wandb"] = path
        found[folder / "files"] = path.parent / "files"
    return found


def renew_links(runs: Path) -> Path:
    """Make the links that are missing, remove those of runs that are gone, and return their folder.

    Raises:
        UserError: when there is no run.
    """
    wanted = links_of(runs)
    if not wanted:
        raise UserError(f"{runs} holds no W&B run; training writes them unless logger.mode=disabled")
    for link in (runs / LINKS).glob("run-*/*"):
        if link.is_symlink() and link not in wanted:
            link.unlink()
    for folder in (runs / LINKS).glob("run-*"):
        if not any(folder.iterdir()):
            folder.rmdir()
    for link, path in wanted.items():
        link.parent.mkdir(parents=True, exist_ok=True)
        if not link.is_symlink():
            link.symlink_to(os.path.relpath(path, link.parent))
    return runs / LINKS


@lines_not_tracebacks
def main(arguments: list[str] | None = None) -> None:
    """Renew the links, and show the runs until `q` is pressed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=Path, default=Path("runs"), help="folder of runs")
    options = parser.parse_args(arguments)
    folder = renew_links(options.runs)
    if not sys.stdout.isatty():
        raise UserError(f"the viewer needs a terminal; there: wandb leet {folder}")
    sys.exit(subprocess.run([sys.executable, "-m", "wandb", "leet", str(folder)], check=False).returncode)


if __name__ == "__main__":
    main()
