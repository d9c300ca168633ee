"""The table of one run: the model between its two yardsticks."""

import math
from collections.abc import Mapping

from omniocc.classes import CLASSES, FREE

ROWS = {"test": "model", "prior": "prior", "label": "label"}
EXPLANATION = (
    "Rays against the true voxels as in the paper (mean over 1, 2, 4 m); 'LiDAR' scores the same voxels against true "
    "LiDAR rays. prior: most frequent training class of every voxel. label: the true voxels themselves, so its LiDAR "
    "column is the ceiling of the grid."
)


def summary(metrics: Mapping[str, float]) -> tuple[list[str], list[list[str]]]:
    """Head and rows of the overview: RayIoU, its distance bands, RayIoU against LiDAR rays, voxel IoU and mIoU."""
    bands = band_keys(metrics)
    columns = ["rayiou", *bands, "lidar/rayiou", "voxel/iou", "voxel/miou"]
    head = [
        "",
        "RayIoU",
        *(band.removeprefix("rayiou_").replace("m", " m") for band in bands),
        "RayIoU, LiDAR",
        "IoU",
        "mIoU",
    ]
    rows = [[label, *(number(metrics.get(f"{row}/{column}")) for column in columns)] for row, label in ROWS.items()]
    return head, rows


def band_keys(metrics: Mapping[str, float]) -> list[str]:
    """The keys `rayiou_<lo>-<hi>m`, nearest band first."""
    keys = [key.removeprefix("test/") for key in metrics if key.startswith("test/rayiou_")]
    return sorted(keys, key=lambda key: float(key.split("_")[1].split("-")[0]))


def per_class(metrics: Mapping[str, float]) -> tuple[list[str], list[list[str]]]:
    """Head and rows of RayIoU by class: model, prior, and both with the ceiling against LiDAR rays."""
    columns = [
        ("model", "test/rayiou"),
        ("prior", "prior/rayiou"),
        ("model, LiDAR", "test/lidar/rayiou"),
        ("prior, LiDAR", "prior/lidar/rayiou"),
        ("label, LiDAR", "label/lidar/rayiou"),
    ]
    rows = [
        [row.name, *(number(metrics.get(f"{key}/{row.name}")) for _, key in columns)]
        for row in CLASSES
        if row.id != FREE
    ]
    return ["class", *(title for title, _ in columns)], rows


def number(value: float | None) -> str:
    """Three digits, a dash for what was not measured or has no cases."""
    return "–" if value is None or math.isnan(value) else f"{value:.3f}"


def markdown(head: list[str], rows: list[list[str]]) -> str:
    """A Markdown table."""
    lines = [head, ["---"] + ["---:"] * (len(head) - 1), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines) + "\n"


def as_markdown(metrics: Mapping[str, float], caption: str) -> str:
    """Both tables and what they mean."""
    return "\n".join([caption, "", markdown(*summary(metrics)), markdown(*per_class(metrics)), EXPLANATION, ""])


def as_text(metrics: Mapping[str, float]) -> str:
    """Both tables for a terminal, in columns."""
    return "\n\n".join(_columns(head, rows) for head, rows in (summary(metrics), per_class(metrics)))


def _columns(head: list[str], rows: list[list[str]]) -> str:
    widths = [max(len(line[i]) for line in [head, *rows]) for i in range(len(head))]
    return "\n".join(
        "  ".join(
            cell.ljust(width) if i == 0 else cell.rjust(width)
            for i, (cell, width) in enumerate(zip(line, widths, strict=True))
        )
        for line in [head, *rows]
    )
