"""Train on rendered streets and show the result beside a baseline, the weights in the package and the true voxels.

`python tools/demo.py [preset] [--full]` is what `make demo` runs. Depth and sketch come from the weights in the package
and the occupancy stage is trained for some minutes; with `--full`, and for other presets than tiny, all are trained.
"""

import argparse
import subprocess
import sys
from pathlib import Path

from make_weights import config_of, folder_of

from omniocc.errors import UserError
from omniocc.io import atomic_write
from omniocc.runs.folder import PAGE
from omniocc.runs.results import EARLIER_MINUTES, IMAGES, METRICS, MINUTES, load_results
from omniocc.runs.script import quiet_libraries
from omniocc.runs.table import BASELINE, BOUND, comparison_cells, in_columns, markdown
from omniocc.runs.weights import SHIPPED, SUFFIX, digest_of, read_weights, shipped

ROOT = Path(__file__).parents[1]
PRESET, WEIGHTS = "tiny", "tiny"
"""The preset that has weights in the package, and their name."""
TABLE = "demo.md"
VIEWED_FRAMES = 8
"""Frames on the page to look at, a second of computing each."""


def overrides_of(preset: str, full: bool) -> list[str]:
    """Return the overrides of `src/train.py`."""
    quick = [] if full or preset != PRESET or WEIGHTS not in shipped() else ["+demo=quick"]
    return ["name=demo", "model=extended", f"preset={preset}", *quick]


def run(script: str, arguments: list[str]) -> None:
    """Run one of the scripts; raise UserError if it fails, after it has said why."""
    if subprocess.run([sys.executable, f"src/{script}", *arguments], cwd=ROOT, check=False).returncode:
        raise UserError("the demo stopped; the same command goes on")


def evaluated(folder: Path, overrides: list[str]) -> Path:
    """Return the folder with the scores of the weights in the package on the scenes of a run."""
    content, _ = read_weights(SHIPPED / f"{WEIGHTS}{SUFFIX}")
    output = folder / f"{WEIGHTS}-{digest_of(content['state_dict'])[:8]}"
    if not (output / METRICS).exists():
        source = config_of({"overrides": overrides}).data.source
        counts = [f"data.source.{key}={source[key]}" for key in ("train_scenes", "val_scenes", "test_scenes")]
        run("evaluate.py", [WEIGHTS, *counts, "--output", str(output)])
    return output


def viewed(folder: Path) -> Path:
    """Return the page on which frames of a run's test can be turned, after writing it if it is missing or older."""
    page = folder / PAGE
    if not page.exists() or page.stat().st_mtime < (folder / METRICS).stat().st_mtime:
        run("view.py", [f"run={folder}", "page=true", f"limit={VIEWED_FRAMES}", f"output={page}"])
    return page


def rows_of(folder: Path, other: Path | None) -> dict[str, tuple[dict[str, float], str]]:
    """Return the rows of the table: baseline, trained here, weights in the package, true voxels."""
    facts, metrics = load_results(folder)
    minutes = facts[MINUTES] + facts.get(EARLIER_MINUTES, 0)
    rows = {BASELINE: (metrics, "prior"), f"trained here, {minutes:.0f} min": (metrics, "test")}
    if other is not None:
        made = read_weights(SHIPPED / f"{WEIGHTS}{SUFFIX}")[1]
        hours = (made.get(MINUTES, 0) + made.get(EARLIER_MINUTES, 0)) / 60
        rows[f"weights '{WEIGHTS}' in the package, {hours:.0f} h"] = (load_results(other)[1], "test")
    return {**rows, BOUND: (metrics, "label")}


def main(preset: str, full: bool) -> None:
    """Train, evaluate the weights in the package on the same test scenes, and print and write the table."""
    quiet_libraries()
    overrides = overrides_of(preset, full)
    run("train.py", overrides)
    folder, _ = folder_of({"stage": "occupancy", "overrides": overrides}, ROOT / "runs")
    other = evaluated(folder, overrides) if preset == PRESET and WEIGHTS in shipped() else None
    table = comparison_cells(rows_of(folder, other))
    atomic_write(folder / TABLE, markdown(*table))
    print("\n" + in_columns(*table))
    for name in (folder, other):
        if name is not None:
            print(f"images    {(name / IMAGES).relative_to(ROOT)}")
    print(f"page      {viewed(folder).relative_to(ROOT)}   open it in a browser: voxels to turn, frame by frame")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("preset", nargs="?", default=PRESET, help=f"of the configuration (default: {PRESET})")
    parser.add_argument("--full", action="store_true", help="train every stage")
    given = parser.parse_args()
    try:
        main(given.preset, given.full)
    except UserError as error:
        sys.exit(str(error))
