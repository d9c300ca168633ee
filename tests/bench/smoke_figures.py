"""Record figures and training losses of rows at preset=smoke, and compare two recordings digit by digit.

The rows are those of the paper, the systems and what goes beyond the paper.

    python tests/bench/smoke_figures.py record before.json
    python tests/bench/smoke_figures.py compare before.json after.json [--renamed renamed.json]

Figures depend on the machine and on the number of threads: record both files on one machine. `renamed.json` maps old
names of figures to new ones.
"""

import argparse
import csv
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

from omniocc.runs.rows import TABLES, known_rows

ROOT = Path(__file__).parents[2]
CONF = ROOT / "conf"
SHOWN = [CONF / TABLES / f"{table}.yaml" for table in ("beyond", "rivals", "bets")]
ROWS = known_rows(CONF, SHOWN)


def record(output: Path, rows: list[str]) -> None:
    """Train every row from nothing with one thread, and write {row: {figure: value}}."""
    figures = {}
    with tempfile.TemporaryDirectory() as folder:
        for row in rows:
            figures[row] = figures_of_row(row, Path(folder))
            print(f"{row}: {len(figures[row])} figures, RayIoU {figures[row].get('test/rayiou')}", flush=True)
            output.write_text(json.dumps(figures, indent=1), encoding="utf-8")


def figures_of_row(row: str, folder: Path) -> dict[str, float]:
    """Train a row below `folder`, which holds the rendered scenes and the stages that rows share."""
    command = [
        sys.executable,
        "src/train.py",
        *ROWS[row],
        "preset=smoke",
        "logger.mode=disabled",
        "test_images=0",
    ]
    command += ["trainer.log_every_n_steps=1"]
    command += [f"paths.data={folder / 'data'}", f"paths.runs={folder / 'runs'}", "trainer.accelerator=cpu"]
    environment = os.environ | {"OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True)
    if done.returncode:
        sys.exit(f"{row} failed:\n{done.stdout}\n{done.stderr}")
    (metrics,) = (folder / "runs").glob(f"{row}-*/metrics.json")
    figures = json.loads(metrics.read_text())["metrics"]
    for curves in (folder / "runs").glob(f"{row}-*/csv/**/metrics.csv"):
        figures |= losses(curves)
    return figures


def losses(curves: Path) -> dict[str, float]:
    """Return every training loss of a CSV file of curves as {name@step: value}."""
    with curves.open(encoding="utf-8") as file:
        rows = [row for row in csv.DictReader(file) if row.get("train/loss")]
    return {
        f"{key}@{row['step']}": float(row[key]) for row in rows for key in row if key.startswith("train/") and row[key]
    }


def compare(before: Path, after: Path, renamed: dict[str, str]) -> list[str]:
    """Return a line for every row or figure that is missing on one side or differs in any digit."""
    old, new = (json.loads(path.read_text()) for path in (before, after))
    lines = [f"row {row} is only in one of the files" for row in sorted(old.keys() ^ new.keys())]
    for row in sorted(old.keys() & new.keys()):
        left = {renamed.get(key, key): repr(value) for key, value in old[row].items()}
        right = {key: repr(value) for key, value in new[row].items()}
        changed = [key for key in sorted(left.keys() | right.keys()) if left.get(key) != right.get(key)]
        lines += [f"{row}: {key}: {left.get(key)} -> {right.get(key)}" for key in changed]
    return lines


def main() -> None:
    """Run the command that the arguments name."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    recording = commands.add_parser("record", help="train every row and write its figures")
    recording.add_argument("output", type=Path)
    recording.add_argument("--rows", nargs="*", choices=ROWS, default=list(ROWS), help="default: all")
    comparing = commands.add_parser("compare", help="list every figure that differs")
    comparing.add_argument("before", type=Path)
    comparing.add_argument("after", type=Path)
    comparing.add_argument("--renamed", type=Path, help="JSON file {old name: new name}")
    options = parser.parse_args()
    if options.command == "record":
        record(options.output, options.rows)
        return
    renamed = json.loads(options.renamed.read_text()) if options.renamed else {}
    lines = compare(options.before, options.after, renamed)
    print("\n".join(lines) or "every figure of every row is the same to the last digit")
    sys.exit(1 if lines else 0)


if __name__ == "__main__":
    main()
