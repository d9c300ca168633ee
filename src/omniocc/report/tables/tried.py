"""Every change that was tried: what differs from one reference row, and the scores on validation scenes."""

import json
from collections.abc import Mapping, Sequence
from typing import Any

from omniocc.errors import UserError
from omniocc.report.runs import FinishedRun
from omniocc.report.selection import ABSENT, compared
from omniocc.report.tables.paper import figure_of, with_spread
from omniocc.run.results import MINUTES
from omniocc.run.slots import slots_of

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
    groups: dict[str, dict[Any, FinishedRun]] = {}
    for run in sorted(
        runs, key=lambda run: run.row == reference
    ):  # of equal runs of a seed, that of the reference counts
        key = json.dumps([compared(run.config), run.facts.get("data")], sort_keys=True)
        groups.setdefault(key, {})[run.facts.get("seed")] = run
    own = [run for members in groups.values() for run in members.values() if run.row == reference]
    if not own:
        raise UserError(f"no finished run of row {reference}, to which the others could be compared")
    base = own[-1].config
    scored = [(figure_of(list(found.values()), "val/rayiou"), list(found.values())) for found in groups.values()]
    ordered = sorted(scored, key=lambda pair: -pair[0].mean if pair[0] else 1.0)
    return ["run", "change", "steps", "seeds", "minutes", *COLUMNS.values()], [
        _line(members, base) for _, members in ordered
    ]


def _line(members: Sequence[FinishedRun], base: Mapping[str, Any]) -> list[str]:
    first = members[0]
    steps = first.facts.get("stages", {})
    minutes = [float(run.facts.get(MINUTES) or 0) for run in members]
    figures = [with_spread(key, figure_of(members, key)) for key in COLUMNS]
    parts = [members[-1].row, changes(first.config, base) or "the reference"]
    parts += ["/".join(str(steps.get(stage, "–")) for stage in STAGES), str(len(members))]
    return [*parts, f"{sum(minutes) / len(minutes):.0f}", *figures]


def changes(config: Mapping[str, Any], base: Mapping[str, Any]) -> str:
    """Return what differs from the reference: `model/<slot>=<option>` of other parts, `key=value` of other settings.

    Settings of a part that was exchanged, and those that only the reference has, are left out.
    """
    ours, theirs = slots_of(config), slots_of(base)
    swapped = {slot: option for slot, option in ours.items() if theirs.get(slot) != option}
    left, right = compared(config), compared(base)
    # a grid or depth network stands in every part that uses it
    keys = [key for key in sorted(left) if not key.startswith("preset.") and not swapped.keys() & set(key.split("."))]
    found = {short(key, left[key]): None for key in keys if left[key] != right.get(key, ABSENT)}
    swaps = [f"model/{slot}={option}" for slot, option in swapped.items()]
    return ", ".join([*swaps, *found])


def short(key: str, value: Any) -> str:
    """Return the last two parts of a setting's name, and its value; of a class only its name."""
    text = str(value).rpartition(".")[2] if key.endswith("_target_") else json.dumps(value).replace('"', "")
    return f"{'.'.join(key.split('.')[-2:]).removesuffix('._target_')}={text}"
