"""Write the report over all runs: tables, plots and pages."""

import importlib.util
from collections.abc import Sequence
from pathlib import Path

from omniocc.errors import installing
from omniocc.io import atomic_write
from omniocc.progress import Progress
from omniocc.report.chapters import report_markdown, write_tables
from omniocc.report.docs import CURVES_IMAGE, write_docs, write_results_into
from omniocc.report.frames import compared_frames
from omniocc.report.page import page
from omniocc.report.sweep import Sweep
from omniocc.report.tables import robustness as disturbed
from omniocc.report.tables import training
from omniocc.report.tables.names import method_names
from omniocc.report.tables.summary import first_lines, summary

SETTINGS = 4
"""Most settings besides the first whose pages are named without --all."""
NO_MATPLOTLIB = f"matplotlib is missing: {installing('plot')}"


def write_documentation(sweeps: Sequence[Sweep], folder: Path, root: Path) -> None:
    """Write pages, CSV and learning curves of all results; for `docs/results` below `root` the README's results too."""
    write_docs(sweeps, folder)
    if folder.resolve() == root / "docs" / "results":
        write_results_into(root / "README.md", sweeps[0])
    draw_curves(sweeps[0], folder)


def draw_curves(sweep: Sweep, folder: Path) -> None:
    """Draw the learning curves into a folder of documentation, if rows have run with several numbers of steps."""
    names = method_names(sweep.tables)
    rows = {names.get(row, row): runs for row, runs in training.runs_by_row(sweep).items()}
    if not rows:
        return
    if importlib.util.find_spec("matplotlib") is None:
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
    if importlib.util.find_spec("matplotlib") is None:
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
    if importlib.util.find_spec("matplotlib") is None:
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
