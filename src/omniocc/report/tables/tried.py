"""Every change that was tried: what differs from one reference row, and the scores on validation scenes."""

import json
from collections.abc import Mapping, Sequence
from typing import Any

from omniocc.errors import UserError
from omniocc.report.runs import FinishedRun
from omniocc.report.selection import ABSENT, compared
from omniocc.report.tables.paper import figure_of, with_spread

TITLE = "Changes that were tried"
NOTE = (
    "Scores on validation scenes, mean ± standard deviation over seeds; test scenes were not looked at. A change names "
    "the settings that differ from the reference."
)
COLUMNS = {
    "val/rayiou": "RayIoU",
    "val/rayiou_0-8.5m": "0-8.5 m",
    "val/rayiou_8.5-17m": "8.5-17 m",
    "val/rayiou_17-25.6m": "17-25.6 m",
    "val/lidar/rayiou": "LiDAR",
    "val/voxel/iou": "IoU",
    "val/voxel/miou": "mIoU",
}
STAGES = ("depth", "sketch", "occupancy")


def tried_cells(runs: Sequence[FinishedRun], reference: str) -> tuple[list[str], list[list[str]]]:
    """Return the head and a line for each configuration, seeds together, by falling RayIoU on validation scenes.

    Args:
        runs: of any settings.
        reference: row to which the others are compared; its newest configuration if it has several.

    Raises:
        UserError: when no run belongs to that row.
    """
    groups: dict[str, list[FinishedRun]] = {}
    for run in runs:
        groups.setdefault(json.dumps([compared(run.config), run.facts.get("data")], sort_keys=True), []).append(run)
    own = [members[0] for members in groups.values() if members[0].row == reference]
    if not own:
        raise UserError(f"no finished run of row {reference}, to which the others could be compared")
    base = compared(own[-1].config)
    scored = [(figure_of(members, "val/rayiou"), members) for members in groups.values()]
    ordered = sorted(scored, key=lambda pair: -pair[0].mean if pair[0] else 1.0)
    return ["run", "change", "steps", "seeds", "minutes", *COLUMNS.values()], [
        _line(members, base) for _, members in ordered
    ]


def _line(members: Sequence[FinishedRun], base: Mapping[str, Any]) -> list[str]:
    first = members[0]
    steps = first.facts.get("stages", {})
    minutes = [float(run.facts.get("minutes of training") or 0) for run in members]
    figures = [with_spread(key, figure_of(members, key)) for key in COLUMNS]
    parts = [first.row, changes(compared(first.config), base) or "the reference"]
    parts += ["/".join(str(steps.get(stage, "–")) for stage in STAGES), str(len(members))]
    return [*parts, f"{sum(minutes) / len(minutes):.0f}", *figures]


def changes(config: Mapping[str, Any], base: Mapping[str, Any]) -> str:
    """Return the settings that differ from the reference, as `key=value`, except those that only the reference has."""
    found = []
    for key in sorted(config.keys() | base.keys()):
        value = config.get(key, ABSENT)
        if value != base.get(key, ABSENT) and value is not ABSENT and not key.startswith("preset."):
            short = ".".join(key.split(".")[-2:])
            found.append(f"{short}={json.dumps(value)}".replace('"', ""))
    return ", ".join(found)
