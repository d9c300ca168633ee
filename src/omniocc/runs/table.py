"""Tables of one run: the model between a baseline and the true voxels."""

import math
import re
from collections.abc import Mapping
from types import MappingProxyType

Cells = tuple[list[str], list[list[str]]]
"""Head and lines of a table."""
BY_CLASS = "test/rayiou/"
LEFT_OUT = "test/lidar/left_out"
"""Fraction of the LiDAR's rays that do not count."""
BAND = re.compile(r"_([\d.]+-[\d.]+m)$")

NOT_RECORDED: Mapping[str, str] = MappingProxyType({})
VOXEL_RAYIOU, SURFACE_RAYIOU = "voxel RayIoU", "surface RayIoU"
SCORES = {"rayiou": VOXEL_RAYIOU, "lidar/rayiou": SURFACE_RAYIOU, "voxel": "IoU, mIoU"}
"""Titles of the kinds of scores whose protocol is recorded, by the beginning of their keys."""
ORIGINS = {"past": "past frames", "now": "the frame itself", "future": "future frames"}
"""Titles of the origins of rays that are scored apart, by the end of their keys."""

BASELINE, BOUND = "baseline (no image)", "upper bound (true voxels)"
ROWS = {"test": "model", "prior": BASELINE, "label": BOUND}
EXPLANATION = (
    "Voxel RayIoU compares rays through the predicted and the true voxels, as in the paper (mean over 1, 2, 4 m). "
    "Surface RayIoU compares the predicted voxels with rays cast at the true surfaces. Baseline: the most frequent "
    "training class of every voxel. Upper bound: the true voxels; its surface RayIoU shows what the cells lose."
)
FIGURE = re.compile(r"[–=]|(?=.*\d)(?:[\s\d.,/()<>%+±*✅☑❌❓–=-]|and|[kM]$)+")
"""What a cell of a column of figures is."""


def summary(metrics: Mapping[str, float]) -> Cells:
    """Return head and rows of the overview: RayIoU, by distance and of surfaces, voxel IoU and mIoU."""
    return comparison_cells({label: (metrics, row) for row, label in ROWS.items()})


def comparison_cells(rows: Mapping[str, tuple[Mapping[str, float], str]]) -> Cells:
    """Return head and rows of the overview of several results, each given by its figures and their prefix."""
    first = next(iter(rows.values()))[0]
    columns = ["rayiou", *band_keys(first), "lidar/rayiou", "voxel/iou", "voxel/miou"]
    titles = [title for title, _ in _bands(first, "test/rayiou_")[1:]]
    head = ["voxels", VOXEL_RAYIOU, *titles, SURFACE_RAYIOU, "IoU", "mIoU"]
    return head, [
        [label, *(number(metrics.get(f"{prefix}/{column}")) for column in columns)]
        for label, (metrics, prefix) in rows.items()
    ]


def band_keys(metrics: Mapping[str, float]) -> list[str]:
    """Return the keys `rayiou_<lo>-<hi>m` of a run's test, nearest band first."""
    return [f"rayiou{suffix}" for _, suffix in _bands(metrics, "test/rayiou_")[1:]]


def class_names(metrics: Mapping[str, float]) -> list[str]:
    """Return the names of the classes in a run's test scores, in the order recorded."""
    return [key.removeprefix(BY_CLASS) for key in metrics if key.startswith(BY_CLASS)]


def band_names(metrics: Mapping[str, float]) -> list[str]:
    """Return the distance bands `<lo>-<hi>m` of any figure of a run's test, nearest first."""
    found = {match[1] for key in metrics if key.startswith("test/") and (match := BAND.search(key))}
    return sorted(found, key=_lower_edge)


def per_class(metrics: Mapping[str, float]) -> Cells:
    """Return head and rows of RayIoU by class: model and baseline, and both with the true voxels on LiDAR rays."""
    columns = [
        ("model", "test/rayiou"),
        ("baseline", "prior/rayiou"),
        ("model, surface", "test/lidar/rayiou"),
        ("baseline, surface", "prior/lidar/rayiou"),
        ("upper bound, surface", "label/lidar/rayiou"),
    ]
    rows = [[name, *(number(metrics.get(f"{key}/{name}")) for _, key in columns)] for name in class_names(metrics)]
    return ["class", *(title for title, _ in columns)], rows


def number(value: float | None) -> str:
    """Return a figure with three decimals; a dash for what was not measured or has no cases."""
    return "–" if value is None or math.isnan(value) else f"{value:.3f}"


def markdown(head: list[str], rows: list[list[str]]) -> str:
    """Return a Markdown table. A cell stays one cell and one line; columns of figures stand to the right."""
    left = text_columns(rows) or [True] * len(head)
    head, *rows = [[" ".join(cell.replace("|", r"\|").splitlines()) for cell in line] for line in (head, *rows)]
    lines = [head, ["---" if is_text else "---:" for is_text in left], *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines) + "\n"


def text_columns(rows: list[list[str]]) -> list[bool]:
    """Return for each column of a table whether it is text, as the first is, or figures."""
    columns = zip(*rows, strict=True)
    return [place == 0 or not all(map(FIGURE.fullmatch, column)) for place, column in enumerate(columns)]


DEPTH_COLUMNS = {
    "mae": "MAE, m",
    "absrel": "AbsRel",
    "rmse": "RMSE, m",
    "index>1": "index > 1 %",
    "index>3": "> 3 %",
    "index>5": "> 5 %",
}
SKETCH_COLUMNS = {"recall": "recall", "precision": "precision", "fraction": "fraction"}
DEPTH_EXPLANATION = (
    "Errors of range over the test panoramas, on every ray with a true range; index: error in percent of the spheres."
)
SKETCH_EXPLANATION = (
    "Candidates against occupied true voxels; fraction: candidates among all voxels. raw: before dilation."
)


def by_origin(metrics: Mapping[str, float]) -> Cells:
    """Return head and rows of RayIoU by origin of the rays: where the car was before, at and after the frame."""
    keys = {title: f"rayiou_{time}" for time, title in ORIGINS.items()} | {"all": "rayiou"}
    rows = [[title, *(number(metrics.get(f"{row}/{key}")) for row in ROWS)] for title, key in keys.items()]
    return ["RayIoU from", *ROWS.values()], rows


def titled(text: str) -> str:
    """Return a text with a capital at its beginning."""
    return text[:1].upper() + text[1:]


def score_of(key: str) -> str | None:
    """Return the kind of score, of `SCORES`, of a figure; None for other figures."""
    name = key.partition("/")[2].replace("fine/", "")  # finer thresholds, same rays
    return next((kind for kind in SCORES if name.startswith(kind)), None)


def protocol_lines(protocol: Mapping[str, str], metrics: Mapping[str, float]) -> list[str]:
    """Return how each kind of score was counted, in one line each; then which fraction of the LiDAR's rays was not."""
    lines = [f"{titled(SCORES[kind])}: {protocol[kind]}." for kind in SCORES if kind in protocol]
    if not math.isnan(metrics.get(LEFT_OUT, math.nan)):
        all_of_them, unknown, free = (100 * metrics[f"{LEFT_OUT}{part}"] for part in ("", "_unknown", "_free"))
        lines.append(f"LiDAR rays that do not count: {all_of_them:.1f} % ({unknown:.1f} % unknown, {free:.1f} % free).")
    return lines


def depth_table(metrics: Mapping[str, float]) -> Cells:
    """Return head and rows by distance band: errors of the panorama of ranges."""
    bands = _bands(metrics, "test/depth/mae_")
    rows = [
        [title, *(number(metrics.get(f"test/depth/{key}{band}")) for key in DEPTH_COLUMNS)] for title, band in bands
    ]
    return ["range", *DEPTH_COLUMNS.values()], rows


def sketch_table(metrics: Mapping[str, float]) -> Cells:
    """Return head and rows by distance band: candidates after dilation, then before."""
    head = ["candidates", *SKETCH_COLUMNS.values(), *(f"{title}, raw" for title in SKETCH_COLUMNS.values())]
    keys = [f"test/sketch/{raw}{key}" for raw in ("", "raw/") for key in SKETCH_COLUMNS]
    bands = _bands(metrics, "test/sketch/recall_")
    return head, [[title, *(number(metrics.get(f"{key}{band}")) for key in keys)] for title, band in bands]


def tables(metrics: Mapping[str, float]) -> list[tuple[Cells, str]]:
    """Return the tables that the figures of a run or stage allow, each with an explanation."""
    found = []
    if "test/rayiou" in metrics:
        found += [(summary(metrics), EXPLANATION), (per_class(metrics), "")]
    if "test/rayiou_now" in metrics:
        found.append((by_origin(metrics), ""))
    if "test/sketch/recall" in metrics:
        found.append((sketch_table(metrics), SKETCH_EXPLANATION))
    if "test/depth/mae" in metrics:
        found.append((depth_table(metrics), DEPTH_EXPLANATION))
    return found


def as_markdown(metrics: Mapping[str, float], caption: str, protocol: Mapping[str, str] = NOT_RECORDED) -> str:
    """Return all tables with their explanations as Markdown, below a caption; then how scores were counted."""
    parts = [part for table, text in tables(metrics) for part in (markdown(*table), text and f"{text}\n")]
    parts += [f"{line}\n" for line in protocol_lines(protocol, metrics)]
    return "\n".join([caption, "", *filter(None, parts)])


def as_text(metrics: Mapping[str, float], protocol: Mapping[str, str] = NOT_RECORDED) -> str:
    """Return all tables for a terminal, in columns; then how scores were counted."""
    lines = "\n".join(protocol_lines(protocol, metrics))
    return "\n\n".join(filter(None, [*(in_columns(*table) for table, _ in tables(metrics)), lines]))


def _bands(metrics: Mapping[str, float], prefix: str) -> list[tuple[str, str]]:
    """Return title and suffix of keys for all distances, then for each band, nearest first."""
    found = {match[1] for key in metrics if (match := BAND.search(key)) and key == f"{prefix}{match[1]}"}
    bands = sorted(found, key=_lower_edge)
    return [("all", ""), *((band.replace("m", " m"), f"_{band}") for band in bands)]


def _lower_edge(band: str) -> float:
    return float(band.split("-")[0])


def in_columns(head: list[str], rows: list[list[str]]) -> str:
    """Return a table for a terminal; the first column is text, the others are figures."""
    widths = [max(len(line[i]) for line in [head, *rows]) for i in range(len(head))]
    align = [str.ljust, *[str.rjust] * (len(head) - 1)]
    table = [head, *rows]
    lines = [[pad(cell, width) for pad, cell, width in zip(align, line, widths, strict=True)] for line in table]
    return "\n".join("  ".join(line) for line in lines)
