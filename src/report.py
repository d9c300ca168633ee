"""Report over all finished runs: `python src/report.py [--runs runs] [--sweeps sweeps] [--output runs/report]`.

Every table of the paper (`sweeps/*.yaml`) is written as Markdown, CSV and LaTeX, with the paper's figures beside ours;
one page has all tables, plots, and the same test frames for all rows. Runs of another preset, number of steps or
dataset have tables and a page of their own in a subfolder; rows of tables may name them, as `ours@3000`. It works also
while a sweep is running. A summary is printed, with `--all` every table. A run belongs to the row of its name
(`+ablation=mono` gives `mono-<hash>`), or else to the row with the same configuration (`make demo FULL=1`: `extended`).

`python src/report.py --compare my_refiner omnidepth_occ` only prints whether one row is ahead of another.
"""

import argparse
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path

from omniocc.errors import installing
from omniocc.io import atomic_write
from omniocc.progress import Progress
from omniocc.report.chapters import report_markdown, write_tables
from omniocc.report.dataset.table import dataset_part, load_dataset_table, with_folders
from omniocc.report.docs import CURVES_IMAGE, write_docs, write_results_into
from omniocc.report.frames import compared_frames
from omniocc.report.keep import keep_records
from omniocc.report.page import page
from omniocc.report.sweep import Sweep, read_sweeps
from omniocc.report.tables import robustness as disturbed
from omniocc.report.tables import training
from omniocc.report.tables.compare import comparison_text
from omniocc.report.tables.formats import parts_text
from omniocc.report.tables.names import method_names
from omniocc.report.tables.summary import first_lines, summary
from omniocc.run.script import lines_not_tracebacks

DATASETS = "dataset.yaml"
SETTINGS = 4
"""Most settings besides the first whose pages are named without --all."""
NO_MATPLOTLIB = f"matplotlib is missing: {installing('plot')}"
ROOT = Path(__file__).parents[1]


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    found = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    found.add_argument("--runs", type=Path, metavar="FOLDER", default=Path("runs"), help="folder of runs")
    tables = "folder of the paper's tables"
    found.add_argument("--sweeps", type=Path, metavar="FOLDER", default=ROOT / "sweeps", help=tables)
    rows = "folder of the configuration"
    found.add_argument("--conf", type=Path, metavar="FOLDER", default=ROOT / "conf", help=rows)
    found.add_argument("--preset", help="only runs of this preset (default: that of most runs)")
    where = "folder of the report (default: report in the folder of runs)"
    found.add_argument("--output", type=Path, metavar="FOLDER", help=where)
    docs = "write pages and CSV of all results too, into this folder; with docs/results also the results in README.md"
    found.add_argument("--docs", type=Path, metavar="FOLDER", help=docs)
    kept = "only copy the figures, configuration and curves of all finished runs there, small enough for a repository"
    found.add_argument("--keep", type=Path, metavar="FOLDER", help=kept)
    compared = "only compare the first of these rows with each other one, such as my_refiner omnidepth_occ"
    found.add_argument("--compare", metavar="ROW", nargs="+", help=compared)
    found.add_argument("--all", action="store_true", help="print every table, which report.md has, not a summary")
    recorded = "only print the paper's Table I with a row for each of these folders of recorded scenes"
    found.add_argument("--datasets", type=Path, metavar="FOLDER", nargs="+", help=recorded)
    return found


@lines_not_tracebacks
def main(arguments: list[str] | None = None) -> None:
    """Read the files of the runs, print the tables and write everything."""
    options = parser().parse_args(arguments)
    if options.datasets is not None:
        table = with_folders(load_dataset_table(options.sweeps / DATASETS), options.datasets)
        print(parts_text([dataset_part(table)]))
        return
    if options.keep is not None:
        print(f"{len(keep_records(options.runs, options.keep))} runs kept in {options.keep}")
        return
    sweeps = read_sweeps(options.runs, options.sweeps, options.conf, options.preset)
    if options.compare is not None:
        print(comparison_text(sweeps, options.compare))
        return
    if options.docs is not None:
        write_docs(sweeps, options.docs)
        if options.docs.resolve() == ROOT / "docs" / "results":
            write_results_into(ROOT / "README.md", sweeps[0])
        draw_curves(sweeps[0], options.docs)
    write_report(sweeps, options.output or options.runs / "report", options.all)


def draw_curves(sweep: Sweep, folder: Path) -> None:
    """Draw the learning curves into a folder of documentation, if rows have run with several numbers of steps."""
    names = method_names(sweep.tables)
    rows = {names.get(row, row): runs for row, runs in training.runs_by_row(sweep).items()}
    if not rows:
        return
    if find_spec("matplotlib") is None:
        print(f"{CURVES_IMAGE} is not drawn again: {NO_MATPLOTLIB}")
        return
    from omniocc.report.plots.figures import learning_curves
    from omniocc.report.plots.svg import save_svg

    if figure := learning_curves(rows):
        save_svg(figure, folder / CURVES_IMAGE)


def write_report(sweeps: Sequence[Sweep], output: Path, whole: bool) -> None:
    """Write tables, plots and a page of every setting, and print a summary of the first, or `whole` all its tables."""
    first, *others = sweeps
    folders = {first.setting: output} | {sweep.setting: output / sweep.setting for sweep in others}
    pages = {setting: folder / "index.html" for setting, folder in folders.items()}
    if find_spec("matplotlib") is None:
        print(f"No plots: {NO_MATPLOTLIB}")
    with Progress("drawing", len(sweeps), unit="settings") as progress:
        for sweep in sweeps:
            folder = folders[sweep.setting]
            write_tables(sweep, folder)
            links = {setting: path for setting, path in pages.items() if setting != sweep.setting}
            plots, frames = draw(sweep, folder), compared_frames(sweep.rows)
            atomic_write(folder / "index.html", page(sweep, plots, frames, folder, links))
            progress.advance()
    links = [f"setting {setting}: {path}" for setting, path in list(pages.items())[1:]]
    print(report_markdown(first) if whole else f"{summary(first)}\n")
    for link in links if whole else first_lines(links, SETTINGS, "settings"):
        print(link)
    print(f"tables  {output / 'report.md'}{'' if whole else ' (--all prints them)'}\npage    {output / 'index.html'}")


def draw(sweep: Sweep, output: Path) -> dict[str, tuple[str, str]]:
    """Write every plot as PNG below `output`, and return title and SVG of each by name."""
    if find_spec("matplotlib") is None:
        return {}
    from omniocc.report.plots import robustness
    from omniocc.report.plots.figures import PLOTS, learning_curves, without_math
    from omniocc.report.plots.svg import as_png, as_svg

    drawn = {}
    figures = {name: (title, plot(without_math(sweep.rows))) for name, (title, plot) in PLOTS.items()}
    if rows := training.runs_by_row(sweep):
        figures["learning-curves"] = (training.CURVES_TITLE, learning_curves(without_math(rows)))
    if sweep.robustness:
        figures["robustness"] = (disturbed.TITLE, robustness.drops(disturbed.comparable(sweep.robustness)[0]))
    for name, (title, figure) in figures.items():
        if figure is not None:
            atomic_write(output / "plots" / f"{name}.png", as_png(figure))
            drawn[name] = (title, as_svg(figure, name, title))
    return drawn


if __name__ == "__main__":
    main()
