"""One web page over a sweep, without any reference to files but those of the runs."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from omniocc.classes import CLASSES, FREE
from omniocc.report import markup
from omniocc.report.tables.budget import BUDGET_NOTE, YARDSTICKS_NOTE, budget_cells, yardstick_cells
from omniocc.report.tables.claims import claim_cells
from omniocc.report.dataset.table import DatasetTable, dataset_cells
from omniocc.report.gallery import GalleryFrame, Shown, inline
from omniocc.report.tables.paper import (
    Figure,
    PaperRow,
    PaperTable,
    has_paper,
    in_cell,
    order_line,
    rows_of,
    source_of,
    with_spread,
)
from omniocc.report.runs import FinishedRun
from omniocc.report.sweep import Sweep, open_ends
from omniocc.run.table import number
from omniocc.view.bev import ERRORS

TEMPLATE = Path(__file__).with_suffix(".html")
CAMERAS_PX, VIEW_PX, MAP_PX = 940, 560, 360


def page(sweep: Sweep, plots: Mapping[str, tuple[str, str]], frames: Sequence[GalleryFrame], folder: Path) -> str:
    """The whole page.

    Args:
        sweep: runs and tables.
        plots: title and SVG of each, by name.
        frames: of the gallery.
        folder: in which the page will lie; links to runs start there.
    """
    pictures = [
        (
            f"plot-{name}",
            title,
            markup.card(f"plot-{name}", title, f'<div class="scroll plot" tabindex="0">{svg}</div>'),
        )
        for name, (title, svg) in plots.items()
    ]
    sections = [
        *pictures[:1],
        ("yardsticks", "Yardsticks", _plain_card("yardsticks", YARDSTICKS_NOTE, *yardstick_cells(sweep.rows))),
        *((table.name, table.title, _dataset_card(table)) for table in sweep.datasets),
        *((table.name, table.title, _table_card(table, sweep)) for table in sweep.tables),
        *pictures[1:],
        *([("gallery", "Same frames, every row", _gallery_card(frames))] if frames else []),
        ("budget", "Budget", _plain_card("budget", BUDGET_NOTE, *budget_cells(sweep.rows))),
        ("runs", "Runs", _runs_card(sweep, folder)),
    ]
    contents = "".join(f"<li>{markup.link(f'#{name}', title)}</li>" for name, title, _ in sections)
    body = [_facts(sweep), f'<nav aria-label="Contents"><ul>{contents}</ul></nav>', *(part for *_, part in sections)]
    return TEMPLATE.read_text("utf-8").replace("__BODY__", "".join(body))


def _facts(sweep: Sweep) -> str:
    seeds = sorted({str(run.facts.get("seed", "?")) for run in sweep.runs})
    minutes = sum(run.facts.get("minutes of training") or 0.0 for run in sweep.runs)
    facts = {
        "Preset": sweep.runs[0].setting[0],
        "Steps": sweep.runs[0].setting[1],
        "Rows, runs": f"{len(sweep.rows)}, {len(sweep.runs)}",
        "Seeds": ", ".join(seeds),
        "Training, occupancy stage": f"{minutes / 60:.1f} h in all",
        "Data": sweep.data or "not on this machine",
    }
    cells = "".join(
        f"<div><dt>{markup.text(key)}</dt><dd>{markup.text(value)}</dd></div>" for key, value in facts.items()
    )
    notes = "".join(map(markup.note, (sweep.remark, *open_ends(sweep))))
    return f'{notes}<dl class="facts">{cells}</dl>'


def _table_card(table: PaperTable, sweep: Sweep) -> str:
    lines = [line for row, figures in rows_of(table, sweep.rows) for line in _pair(table, row, figures, sweep)]
    head = ["method", "", *map(markup.text, table.columns.values())]
    order = markup.note(order_line(table, sweep.rows))
    claims_head, claims = claim_cells(table, sweep.rows)
    answer = order + (markup.plain_table(claims_head, claims, "claims") if claims else "")
    wide = len(table.columns) > 5
    body = markup.table(head, lines, "pairs wide" if wide else "pairs")
    both = f'<div class="{"stack" if wide else "sides"}"><div>{body}</div><div>{answer}</div></div>'
    return markup.card(table.name, table.title, markup.note(table.note), both, _files(table.name))


def _pair(table: PaperTable, row: PaperRow, figures: Sequence[Figure | None], sweep: Sweep) -> list[list[str]]:
    """The paper's line and ours, or ours alone."""
    source, *cells = (
        _linked(row.run, cell, sweep) for cell in (source_of(figures), *map(with_spread, table.columns, figures))
    )
    name, ours = markup.text(row.title), [markup.cell(source, "source"), *cells]
    if not has_paper(row):
        return [[markup.cell(name, "name"), *ours]]
    paper = (f'<span class="soft">{in_cell(key, value)}</span>' for key, value in row.paper.items())
    return [[markup.cell(name, "name", 2), markup.cell("paper", "source soft"), *paper], ours]


def _linked(row: str, cell: str, sweep: Sweep) -> str:
    if row not in sweep.rows:
        return f'<span class="soft">{markup.text(cell)}</span>'
    mean, *spread = cell.split(" ± ")
    return markup.link(f"#row-{row}", mean) + "".join(f" <small>± {part}</small>" for part in spread)


def _plain_card(name: str, note: str, head: list[str], lines: list[list[str]]) -> str:
    return markup.card(name, name.capitalize(), markup.note(note), markup.plain_table(head, lines))


def _dataset_card(table: DatasetTable) -> str:
    return markup.card(
        table.name, table.title, markup.note(table.note), markup.plain_table(*dataset_cells(table)), _files(table.name)
    )


def _files(name: str) -> str:
    return f'<p class="note">{markup.link(f"{name}.csv", "CSV")} · {markup.link(f"{name}.tex", "LaTeX")}</p>'


def _gallery_card(frames: Sequence[GalleryFrame]) -> str:
    classes = [markup.swatch(entry.rgb, entry.name) for entry in CLASSES if entry.id != FREE]
    errors = [markup.swatch(rgb, f"difference: {name}" if k == 0 else name) for k, (name, rgb) in enumerate(ERRORS)]
    legend = f'<p class="legend">{"".join([*classes, *errors])}</p>'
    blocks = []
    for k, frame in enumerate(frames):
        cameras = inline(frame.shown[0].parts.cameras, CAMERAS_PX)
        rows = "".join(map(_shown, frame.shown))
        title = markup.text(f"{frame.scene}, frame {int(frame.frame)}")
        blocks.append(
            f"<details{' open' * (k == 0)}><summary>{title}</summary>"
            f'<div class="cameras">{markup.picture(cameras, "pictures of the cameras")}</div>{rows}</details>'
        )
    text = "Test frames, as the first seed of each row sees them; the truth once for each grid."
    return markup.card("gallery", "Same frames, every row", markup.note(text), legend, *blocks)


def _shown(shown: Shown) -> str:
    parts, lines = shown.parts, ""
    if shown.grid:
        lines += _strip(
            f"truth, {shown.grid}", shown.row, (parts.truth, parts.truth_map, None), "true voxels on the grid of "
        )
    score = f"RayIoU {number(shown.run.metrics.get('test/rayiou'))} over the test"
    label = f"{markup.link(f'#row-{shown.row}', shown.row)}<small>{score}</small>"
    return lines + _strip(
        label, shown.row, (parts.prediction, parts.prediction_map, parts.differences), "predicted by "
    )


def _strip(label: str, row: str, pictures: Sequence, alt: str) -> str:
    kinds = (("", VIEW_PX), (", from above", MAP_PX), (", differences", MAP_PX))
    cells = "".join(
        markup.picture(inline(part, width), f"{alt}{row}{kind}") if part is not None else "<figure></figure>"
        for part, (kind, width) in zip(pictures, kinds, strict=True)
    )
    return f'<div class="strip"><div class="label">{label}</div>{cells}</div>'


def _runs_card(sweep: Sweep, folder: Path) -> str:
    blocks = [_row_block(row, runs, folder) for row, runs in sweep.rows.items()]
    return markup.card("runs", "Runs", *blocks)


def _row_block(row: str, runs: Sequence[FinishedRun], folder: Path) -> str:
    head = ["run", "seed", "RayIoU", "RayIoU, LiDAR", "mIoU", "minutes", "commit", "files"]
    lines, commands = [], []
    for run in runs:
        where = markup.path_between(folder, run.folder)
        files = [markup.link(f"{where}/{name}", name) for name in ("config.yaml", "metrics.json", "table.md")]
        figures = [number(run.metrics.get(f"test/{key}")) for key in ("rayiou", "lidar/rayiou", "voxel/miou")]
        facts = [str(run.facts.get(key, "–")) for key in ("minutes of training", "commit")]
        seed = str(run.facts.get("seed", "–"))
        lines.append([markup.link(f"{where}/", run.name), seed, *figures, *map(markup.text, facts), " ".join(files)])
        commands.append(f"<pre>{markup.text(str(run.facts.get('command', 'command not recorded')))}</pre>")
    table = markup.table(head, lines)
    return f'<div class="row" id="row-{row}"><h3>{markup.text(row)}</h3>{table}{"".join(dict.fromkeys(commands))}</div>'
