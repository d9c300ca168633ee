"""Write tables, plots and pages of all finished runs: `python src/report.py [--runs runs] [--output runs/report]`.

Every table of the paper (`sweeps/*.yaml`) is written as Markdown, CSV and LaTeX, with the paper's figures beside ours;
one page has all tables, plots, and the same test frames for all rows. Runs of another preset, number of steps or
dataset have tables and a page of their own in a subfolder; rows of tables may name them, as `ours@3000`. It works also
while a sweep is running. A summary is printed, with `--all` every table. A run belongs to the row of its name
(`+ablation=mono` gives `mono-<hash>`), or else to the row with the same configuration (`make demo FULL=1`: `extended`).

A folder of runs may also be one file (`docs/results/runs.tar.xz`), which `--runs` reads and `--keep` adds to.

`python src/report.py --compare my_refiner omnidepth_occ` only prints whether one row is ahead of another.
"""

import argparse
from functools import partial
from pathlib import Path

from omniocc.config import CONF
from omniocc.runs.script import lines_not_tracebacks

DATASETS = "dataset.yaml"
ROOT = CONF.parent
"""The folder of this repository; in an installed package its own, with the same folders."""


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    found = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    folder = partial(found.add_argument, type=Path, metavar="FOLDER")
    folder("--runs", default=Path("runs"), help="folder of runs, or their archive (.tar.xz)")
    folder("--sweeps", default=ROOT / "sweeps", help="folder of the paper's tables")
    folder("--conf", default=ROOT / "conf", help="folder of the configuration")
    folder("--output", help="folder of the report (default: report in the folder of runs, or beside their archive)")
    docs = "write pages and CSV of all results too, into this folder; with docs/results also the results in README.md"
    folder("--docs", help=docs)
    kept = "only copy the figures, configuration and curves of all finished runs into this folder or archive (.tar.xz)"
    folder("--keep", help=kept)
    recorded = "only print the paper's Table I with a row for each of these folders of recorded scenes"
    folder("--datasets", nargs="+", help=recorded)
    found.add_argument("--preset", help="only runs of this preset (default: that of most runs)")
    compared = "only compare the first of these rows with each other one, such as my_refiner omnidepth_occ"
    found.add_argument("--compare", metavar="ROW", nargs="+", help=compared)
    found.add_argument("--all", action="store_true", help="print every table, which report.md has, not a summary")
    return found


@lines_not_tracebacks
def main(arguments: list[str] | None = None) -> None:
    """Read the files of the runs, print the tables and write everything."""
    options = parser().parse_args(arguments)
    from omniocc.report.archive import folder_of, is_archive
    from omniocc.report.datasets import dataset_part, load_dataset_table, with_folders
    from omniocc.report.docs import write_documentation
    from omniocc.report.keep import keep_records
    from omniocc.report.sweep import read_sweeps
    from omniocc.report.tables.compare import comparison_text
    from omniocc.report.tables.formats import parts_text
    from omniocc.report.write import write_report

    if options.datasets is not None:
        print(parts_text([dataset_part(with_folders(load_dataset_table(options.sweeps / DATASETS), options.datasets))]))
    elif options.keep is not None:
        with folder_of(options.runs) as runs, folder_of(options.keep, to_change=True) as kept:
            print(f"{len(keep_records(runs, kept))} runs kept in {options.keep}")
    else:
        with folder_of(options.runs) as runs:
            sweeps = read_sweeps(runs, options.sweeps, options.conf, options.preset)
            if options.compare is not None:
                print(comparison_text(sweeps, options.compare))
                return
            if options.docs is not None:
                write_documentation(sweeps, options.docs, ROOT)
            beside = options.runs.parent if is_archive(options.runs) else options.runs
            write_report(sweeps, options.output or beside / "report", options.all)


if __name__ == "__main__":
    main()
