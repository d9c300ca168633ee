"""The card of a file of weights: what it is, how it was made, how good it is, what it is not good for."""

import math
import re
from collections.abc import Mapping
from typing import Any

BANDS = ("0-8.5m", "8.5-17m", "17-25.6m")
"""Distance bands of the figures, as in the keys of metrics."""


def card(
    name: str,
    purpose: Mapping[str, str],
    facts: Mapping[str, Any],
    metrics: Mapping[str, float],
    on_frames: Mapping[str, float],
) -> str:
    """Return the card as Markdown.

    Args:
        name: of the weights.
        purpose: `good_for` and `not_good_for`.
        facts: command, commit, data, steps, file size in MB, ...; listed as they are.
        metrics: of the test, `test/...`; those of voxels, rays and ranges are shown where they exist.
        on_frames: the same of the four frames that the tests of the weights use.
    """
    lines = [f"# {name}", "", f"Good for {purpose['good_for']}.", ""]
    if purpose.get("not_good_for"):
        lines += [f"Not good for {purpose['not_good_for']}.", ""]
    lines += [
        "| made by | value |",
        "|---|---|",
        *(f"| {key} | {_code(key, value)} |" for key, value in facts.items()),
        "",
    ]
    sections = {"Scores on unseen scenes": score_rows(metrics), "By kind of rig": rig_rows(metrics)}
    sections["Errors of range"] = depth_rows(metrics)
    sections["On the four frames of the tests"] = frame_rows(on_frames)
    for title, rows in sections.items():
        if rows:
            lines += [f"## {title}", "", *rows, ""]
    return "\n".join(lines)


def score_rows(metrics: Mapping[str, float]) -> list[str]:
    """Return a table of RayIoU, by distance and class; nothing without these figures."""
    if "test/rayiou" not in metrics:
        return []
    keys = ["test/rayiou", *(f"test/rayiou_{band}" for band in BANDS), "test/lidar/rayiou", "test/voxel/iou"]
    keys += ["test/voxel/miou", *sorted(key for key in metrics if key.startswith("test/rayiou/"))]
    return _table([(_title(key), metrics[key]) for key in keys if key in metrics], 3)


def rig_rows(metrics: Mapping[str, float]) -> list[str]:
    """Return a table of RayIoU by kind of rig; nothing where all scenes have the same."""
    of_kind = re.compile(r"test/rig/([^/]+)/rayiou")
    found = [(match[1], metrics[key]) for key in sorted(metrics) if (match := of_kind.fullmatch(key))]
    return _table([(f"voxel RayIoU, {kind}", value) for kind, value in found], 3)


def depth_rows(metrics: Mapping[str, float]) -> list[str]:
    """Return a table of mean absolute errors, m, by distance, and of the confidence; nothing without these figures."""
    keys = ["test/depth/mae", *(f"test/depth/mae_{band}" for band in BANDS)]
    keys += ["test/depth/coverage", "test/depth/ece"]
    return _table([(_title(key), metrics[key]) for key in keys if key in metrics], 3)


def frame_rows(metrics: Mapping[str, float]) -> list[str]:
    """Return a table of one score of each kind, with more digits."""
    keys = ("test/rayiou", "test/voxel/miou", *(f"test/depth/mae{band}" for band in ("", *(f"_{b}" for b in BANDS))))
    return _table([(_title(key), metrics[key]) for key in keys if key in metrics], 4)


def _table(rows: list[tuple[str, float]], digits: int) -> list[str]:
    if not rows:
        return []
    body = [f"| {title} | {'-' if math.isnan(value) else f'{value:.{digits}f}'} |" for title, value in rows]
    return ["| figure | value |", "|---|---:|", *body]


def _title(key: str) -> str:
    """Return words for a key of metrics."""
    words = {"test/rayiou": "voxel RayIoU", "test/lidar/rayiou": "surface RayIoU", "test/voxel/iou": "voxel IoU"}
    words |= {"test/voxel/miou": "voxel mIoU", "test/depth/mae": "MAE, m", "test/depth/coverage": "with an answer"}
    words["test/depth/ece"] = "calibration error of the confidence"
    for start, title in words.items():
        if key.startswith(start):
            rest = key.removeprefix(start)
            part = rest[1:].replace("m", " m") if rest.startswith("_") else rest[1:]
            return f"{title}, {part}" if part else title
    return key


def _code(key: str, value: object) -> str:
    return f"`{value}`" if key in ("command", "commit", "data", "sha256") else str(value)
