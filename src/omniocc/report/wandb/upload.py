"""Offline W&B runs to the server: `python -m omniocc.report.wandb.upload [--runs runs]`, or `make wandb-sync`."""

import argparse
import csv
import hashlib
import os
import struct
import subprocess
import sys
import time
from pathlib import Path

from omniocc.errors import UserError
from omniocc.lock import Held, acquire
from omniocc.runs.script import lines_not_tracebacks
from omniocc.runs.wandb.loggers import check_login

HEADER_BYTES, BLOCK_BYTES = 7, 32768
PART = struct.Struct("<IHB")
"""Checksum, length and kind of a record or a part of one."""
FULL, LAST = 1, 4
"""Kinds that end a record."""
QUIET_S = 60
"""W&B writes to the file of a run in progress every 15 s."""


def whole_bytes(content: bytes) -> int:
    """Return how many bytes the whole records of a file take, with the header; 0 without any."""
    at, end = HEADER_BYTES, 0
    while at + PART.size <= len(content):
        left = BLOCK_BYTES - at % BLOCK_BYTES
        _, length, kind = PART.unpack_from(content, at) if left >= PART.size else (0, 0, 0)
        if kind == 0:  # padding at the end of a block
            at += left
            continue
        at += PART.size + length
        if at <= len(content) and kind in (FULL, LAST):
            end = at
    return end


def remove_half_record(path: Path) -> None:
    """Cut a file after its last whole record, unless it has been written to in the last minute."""
    end = whole_bytes(path.read_bytes())
    if 0 < end < path.stat().st_size and time.time() - path.stat().st_mtime > QUIET_S:
        os.truncate(path, end)


OFFLINE = "wandb/offline-run-*/run-*.wandb"
MARK = ".synced"
"""Suffix of the empty file that `wandb sync` creates beside uploaded files."""


def pending_runs(runs: Path) -> list[Path]:
    """Return files of offline runs that have not been uploaded, without runs in progress."""
    files = sorted(runs.glob(f"**/{OFFLINE}"))
    left = [path for path in files if not _is_marked(path)]
    busy = {folder for folder in {path.parents[2] for path in left} if in_use(folder)}  # folders of runs
    return [path for path in left if path.parents[2] not in busy]


def in_use(folder: Path) -> bool:
    """Return whether a process holds the lock of a run's folder."""
    if not (folder / ".lock").exists():
        return False
    try:
        acquire(folder / ".lock").release()
    except Held:
        return True
    return False


def log_report(report: Path, project: str) -> bool:
    """Log the tables of a report (the CSV files in its folder) as an offline W&B run of job type `report`.

    Return False if that has been done already, or there is no table.
    """
    files = sorted(report.glob("*.csv"))
    text = "".join(path.name + path.read_text("utf-8") for path in files)
    name = hashlib.sha256(f"{report.resolve()}\n{text}".encode()).hexdigest()[:16]
    if not files or list(report.glob(f"wandb/*-{name}")):
        return False
    import wandb

    quiet = wandb.Settings(silent=True)  # not by the environment, which `wandb sync` inherits
    with wandb.init(
        dir=report, id=name, name="report", project=project, job_type="report", mode="offline", settings=quiet
    ) as run:
        for path in files:
            head, *rows = csv.reader(path.read_text("utf-8").splitlines())
            run.log({f"paper/{path.stem}": wandb.Table(columns=[*head], data=rows)})
    wandb.teardown()  # `finish` alone may return before the file is whole
    return True


def upload(files: list[Path]) -> None:
    """Upload files of offline runs.

    Raises:
        UserError: when one has not been uploaded to its end.
    """
    for path in files:
        remove_half_record(path)
    subprocess.run([sys.executable, "-m", "wandb", "sync", *map(str, files)], check=False)
    left = [path for path in files if not _is_marked(path)]  # `wandb sync` ends with 0 whatever fails
    if left:
        raise UserError(f"{len(left)} of {len(files)} files still wait, for the reasons above; the first is {left[0]}")


def _is_marked(path: Path) -> bool:
    return path.with_name(path.name + MARK).exists()


@lines_not_tracebacks
def main(arguments: list[str] | None = None) -> None:
    """Log the report if it is new, then upload all waiting files."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=Path, default=Path("runs"), help="folder of runs")
    parser.add_argument("--project", default="omniocc", help="W&B project of the report; runs name their own")
    options = parser.parse_args(arguments)
    log_report(options.runs / "report", options.project)
    # the file of a run that was killed at once holds nothing whole
    files = [path for path in pending_runs(options.runs) if whole_bytes(path.read_bytes())]
    if not files:
        print(f"{options.runs}: nothing waits for upload")
        return
    check_login(f"{len(files)} files wait in {options.runs}")
    upload(files)


if __name__ == "__main__":
    main()
