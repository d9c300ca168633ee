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
from omniocc.report.chapters import CURVES_IMAGE, report_markdown, write_docs, write_results_into, write_tables
from omniocc.report.dataset.table import dataset_markdown, load_dataset_table, with_folders
from omniocc.report.frames import compared_frames
from omniocc.report.keep import keep_records
from omniocc.report.page import page
from omniocc.report.runs import read_runs
from omniocc.report.sweep import Sweep, read_sweeps
from omniocc.report.tables import robustness as disturbed
from omniocc.report.tables import training
from omniocc.report.tables.compare import comparison_text
from omniocc.report.tables.power import power_chapter, seed_std_of
from omniocc.report.tables.summary import first_lines, summary
from omniocc.report.tables.tried import tried_chapter
from omniocc.run.script import lines_not_tracebacks

DATASETS = "dataset.yaml"
SETTINGS = 4
"""Most settings besides the first whose pages are named without --all."""
NO_MATPLOTLIB = f"matplotlib is missing: {installing('plot')}"
ROOT = Path(__file__).parents[1]
GENERATED_TRIED = "<!-- Written by `python src/report.py --tried`; do not edit. -->"


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
    docs = "write the tables as Markdown pages too, into this folder; with docs/results also the results in README.md"
    found.add_argument("--docs", type=Path, metavar="FOLDER", help=docs)
    tried = "only write one table of all runs, of any setting, on validation scenes"
    found.add_argument("--tried", type=Path, metavar="FILE", help=tried)
    found.add_argument("--reference", default="ours", help="row to which --tried compares the others (default: ours)")
    kept = "only copy the figures, configuration and curves of all finished runs there, small enough for a repository"
    found.add_argument("--keep", type=Path, metavar="FOLDER", help=kept)
    compared = "only compare the first of these rows with each other one, such as my_refiner omnidepth_occ"
    found.add_argument("--compare", metavar="ROW", nargs="+", help=compared)
    found.add_argument("--all", action="store_true", help="print every table, which report.md has, not a summary")
    recorded = "only print the paper's Table I with a row for each of these folders of recorded scenes"
    found.add_argument("--datasets", type=Path, metavar="FOLDER", nargs="+", help=recorded)
    seeds = (
        "only print how many seeds the paper's gaps need, at two standard deviations between seeds, of parts and of "
    )
    seeds += "systems, such as 0.004 0.01 (default: those of sweeps/power.yaml), and at those of the runs"
    found.add_argument("--power", type=float, metavar="STD", nargs="*", help=seeds)
    return found


@lines_not_tracebacks
def main(arguments: list[str] | None = None) -> None:
    """Read the files of the runs, print the tables and write everything."""
    options = parser().parse_args(arguments)
    if options.datasets is not None:
        print(dataset_markdown(with_folders(load_dataset_table(options.sweeps / DATASETS), options.datasets)))
        return
    if options.keep is not None:
        print(f"{len(keep_records(options.runs, options.keep))} runs kept in {options.keep}")
        return
    if options.tried is not None:
        write_tried(options.runs, options.tried, options.reference)
        return
    sweeps = read_sweeps(options.runs, options.sweeps, options.conf, options.preset)
    if options.compare is not None:
        print(comparison_text(sweeps, options.compare))
        return
    if options.power is not None:
        given = [seed_std_of(options.power)] if options.power else sweeps[0].seed_stds
        print(power_chapter(sweeps[0].tables, sweeps[0].table_rows, given))
        return
    if options.docs is not None:
        write_docs(sweeps, options.docs)
        if options.docs.resolve() == ROOT / "docs" / "results":
            write_results_into(ROOT / "README.md", sweeps[0])
        draw_curves(sweeps[0], options.docs)
    write_report(sweeps, options.output or options.runs / "report", options.all)


def draw_curves(sweep: Sweep, folder: Path) -> None:
    """Draw the image of the page on more steps into a folder of documentation, if there are such runs."""
    rows = training.runs_by_row(sweep)
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
    for sweep in sweeps:
        folder = folders[sweep.setting]
        write_tables(sweep, folder)
        links = {setting: path for setting, path in pages.items() if setting != sweep.setting}
        plots, frames = draw(sweep, folder), compared_frames(sweep.rows)
        atomic_write(folder / "index.html", page(sweep, plots, frames, folder, links))
    links = [f"setting {setting}: {path}" for setting, path in list(pages.items())[1:]]
    print(report_markdown(first) if whole else f"{summary(first)}\n")
    for link in links if whole else first_lines(links, SETTINGS, "settings"):
        print(link)
    print(f"tables  {output / 'report.md'}{'' if whole else ' (--all prints them)'}\npage    {output / 'index.html'}")


def write_tried(folder: Path, path: Path, reference: str) -> None:
    """Write what was tried as a page of the documentation, with the command that writes it."""
    text = f"{GENERATED_TRIED}\n\n{tried_chapter(read_runs(folder), reference).removeprefix('#')}"
    atomic_write(path, text)
    print(f"{text}\npage    {path}")


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
