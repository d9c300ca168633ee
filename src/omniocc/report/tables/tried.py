"""Every change that was tried: what differs from one reference row, and the scores on validation scenes."""

import json
from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Any

from omniocc.errors import UserError
from omniocc.report.runs import FinishedRun
from omniocc.report.selection import comparable_config, counted_otherwise, given_values, preference
from omniocc.report.tables.budget import steps_of_stages
from omniocc.report.tables.formats import csv_text
from omniocc.report.tables.paper import SPREAD, figure_of, spread_cells
from omniocc.runs.results import MINUTES
from omniocc.runs.slots import slots_of
from omniocc.runs.table import SURFACE_RAYIOU, VOXEL_RAYIOU, Cells, band_names

LAST = {"val/lidar/rayiou": SURFACE_RAYIOU, "val/voxel/iou": "IoU", "val/voxel/miou": "mIoU"}


def columns_of(runs: Sequence[FinishedRun]) -> dict[str, str]:
    """Return the titles of the columns by the keys of their figures, with the bands of distance of the runs."""
    bands = dict.fromkeys(band for run in runs for band in band_names(run.metrics))
    return {"val/rayiou": VOXEL_RAYIOU} | {f"val/rayiou_{band}": band.replace("m", " m") for band in bands} | LAST


def tried_csv(runs: Sequence[FinishedRun], reference: str) -> str:
    """Return CSV of all runs whose scores are counted as the reference's; errors as those of `tried_cells`."""
    otherwise = counted_otherwise(runs, [run for run in runs if run.row == reference])
    head, lines = tried_cells([run for run in runs if run.name not in otherwise], reference)
    return csv_text(head, lines)


def tried_cells(runs: Sequence[FinishedRun], reference: str) -> Cells:
    """Return the head and a line for each configuration, seeds together, by falling RayIoU on validation scenes.

    Args:
        runs: of any settings; those of another preset than the reference are left out.
        reference: row to which the others are compared; its newest configuration if it has several.

    Raises:
        UserError: when no run belongs to that row.
    """
    groups: dict[str, dict[Any, FinishedRun]] = {}
    # of a seed's runs with equal settings and data one counts: of the reference before others, then by `preference`
    for run in sorted(runs, key=lambda run: (run.row == reference, *preference(run))):
        key = json.dumps([given_values(run.config), run.facts.get("data")], sort_keys=True)
        groups.setdefault(key, {})[run.facts.get("seed")] = run
    own = [run for members in groups.values() for run in members.values() if run.row == reference]
    if not own:
        raise UserError(f"no finished run of row {reference}, to which the others could be compared")
    base, preset = own[-1].config, own[-1].setting[0]
    kept = [list(found.values()) for found in groups.values() if next(iter(found.values())).setting[0] == preset]
    scored = [(figure_of(members, "val/rayiou"), members) for members in kept]
    ordered = sorted(scored, key=lambda pair: -pair[0].mean if pair[0] else 1.0)
    columns = columns_of([run for members in kept for run in members])
    spread = [f"validation {title}, {column}" for title in columns.values() for column in SPREAD[:-1]]
    return ["row", "change", "steps of depth, sketch and occupancy", "seeds", "minutes", *spread], [
        _line(members, base, columns) for _, members in ordered
    ]


def _line(members: Sequence[FinishedRun], base: Mapping[str, Any], columns: Iterable[str]) -> list[str]:
    first = members[0]
    minutes = [float(run.facts.get(MINUTES) or 0) for run in members]
    figures = [cell for key in columns for cell in spread_cells(figure_of(members, key))[:-1]]
    parts = [members[-1].row, changes(first.config, base) or "the reference"]
    parts += [steps_of_stages(first), str(len(members))]
    return [*parts, f"{sum(minutes) / len(minutes):.0f}", *figures]


def changes(config: Mapping[str, Any], base: Mapping[str, Any]) -> str:
    """Return what differs from the reference: `model/<slot>=<option>` of other parts, `key=value` of other settings.

    A part that only one of the two has is named once, `none` if it is the reference that has it. Left out are settings
    of a part that was exchanged, and those that the other's commit did not know yet.
    """
    ours, theirs = slots_of(config), slots_of(base)
    swapped = {slot: option for slot, option in ours.items() if theirs.get(slot) != option}
    left, right = _settings(config, swapped.keys()), _settings(base, swapped.keys())
    added, gone = _parts(left) - _parts(right), _parts(right) - _parts(left)
    swaps = [f"model/{slot}={option}" for slot, option in swapped.items()]
    parts = [short(f"{part}._target_", left[f"{part}._target_"]) for part in _outermost(added)]
    parts += [f"{part.rpartition('.')[2]}=none" for part in _outermost(gone)]
    found = [short(key, left[key]) for key in sorted(left.keys() & right.keys()) if left[key] != right[key]]
    return ", ".join([*swaps, *dict.fromkeys([*parts, *found])])


def _settings(config: Mapping[str, Any], swapped: Collection[str]) -> dict[str, Any]:
    """Return the settings outside exchanged slots, by dotted key.

    A grid or depth network stands in every part that uses it.
    """
    of_parts = {key: value for key, value in comparable_config(config).items() if not key.startswith("preset.")}
    return {key: value for key, value in of_parts.items() if not set(swapped) & set(key.split("."))}


def _parts(settings: Iterable[str]) -> set[str]:
    return {key.removesuffix("._target_") for key in settings if key.endswith("._target_")}


def _outermost(parts: Collection[str]) -> list[str]:
    """Return the parts that are not inside another of them."""
    return [part for part in sorted(parts) if not any(part.startswith(f"{other}.") for other in parts)]


def short(key: str, value: Any) -> str:
    """Return the last two parts of a setting's name, and its value; of a class only its name."""
    text = str(value).rpartition(".")[2] if key.endswith("_target_") else json.dumps(value).replace('"', "")
    return f"{'.'.join(key.split('.')[-2:]).removesuffix('._target_')}={text}"
