"""What breaks each system: relative losses by kind of disturbance, and every disturbance alone."""

import math
import statistics
from collections.abc import Mapping, Sequence

import numpy as np

from omniocc.report.runs import HASH
from omniocc.report.tables.formats import Part, csv_text, exact
from omniocc.report.tables.names import named
from omniocc.runs.robustness import WITHIN, PartScores, Robustness, drop_of, drops_by_kind, relative_drop
from omniocc.runs.table import SURFACE_RAYIOU, VOXEL_RAYIOU, Cells, number

TITLE = "What breaks them"
NOTE = (
    "RayIoU of the same test scenes with something wrong. A loss is the score without disturbance minus that with it. "
    "A relative loss is in percent of the system's own undisturbed score; the mean is that over kinds of disturbances. "
    "A system that scores little has little to lose, so the last line has the RayIoU after the mean loss."
)
PARTS_NOTE = "In brackets: the standard error over scenes (jackknife)."
SCORES = {"rayiou": VOXEL_RAYIOU, "lidar/rayiou": SURFACE_RAYIOU, "voxel/iou": "IoU", "voxel/miou": "mIoU"}


def system_names(records: Sequence[Robustness]) -> list[str]:
    """Return the names of systems in tables: their rows.

    Systems of the same row are told apart by steps and seed of their training, or by their folders if these are unknown
    or the same.
    """
    rows = [HASH.sub("", record.system) for record in records]
    apart = [f"{row}, {one.training}" if one.training else one.system for row, one in zip(rows, records, strict=True)]
    return [
        next((names[place] for names in (rows, apart) if names.count(names[place]) == 1), one.system)
        for place, one in enumerate(records)
    ]


def comparable(records: Sequence[Robustness]) -> list[list[Robustness]]:
    """Return the records of each setting (scenes, data, seed), the setting of most of them first."""
    settings: dict[str, list[Robustness]] = {}
    for record in records:
        settings.setdefault(str(record.facts.get("setting")), []).append(record)
    return sorted(settings.values(), key=len, reverse=True)


def common_parts(records: Sequence[Robustness]) -> list[str]:
    """Return the disturbances that all systems were tested with, in order."""
    others = [{part.part for part in record.disturbed} for record in records[1:]]
    return [part.part for part in records[0].disturbed if all(part.part in names for names in others)]


def relative_cells(records: Sequence[Robustness], names: Sequence[str] = ()) -> Cells:
    """Return head and rows: the mean relative loss by kind of disturbance, the least in bold, then their mean.

    The first row is the undisturbed RayIoU, the last the RayIoU after the mean relative loss. Systems of the same name
    are one column, of their means.
    """
    columns: dict[str, list[Robustness]] = {}
    for name, record in zip(names or system_names(records), records, strict=True):
        columns.setdefault(name, []).append(record)
    parts = set(common_parts(records))
    drops, undisturbed = [], []
    for members in columns.values():
        each = [drops_by_kind(record, parts) for record in members]
        drops.append({group: statistics.fmean(one[group] for one in each) for group in each[0]})
        undisturbed.append(statistics.fmean(one.undisturbed.scores.get("rayiou", math.nan) for one in members))
    rows = [[f"undisturbed {VOXEL_RAYIOU}", *map(number, undisturbed)]]
    rows += [[group.replace("_", " "), *_least_bold([one[group] for one in drops])] for group in drops[0]]
    if drops[0]:
        means = [mean_drop(one) for one in drops]
        left = [score * (1 - mean) for score, mean in zip(undisturbed, means, strict=True)]
        rows += [["mean of all kinds", *_least_bold(means)], [f"{VOXEL_RAYIOU} after it", *map(number, left)]]
    return [f"Loss of {VOXEL_RAYIOU}, %", *columns], rows


def mean_drop(drops: dict[str, float]) -> float:
    """Return the mean over kinds of disturbances, which count equally; nan where none is known."""
    return float(np.nanmean(list(drops.values()))) if not all(map(math.isnan, drops.values())) else math.nan


def verdict(records: Sequence[Robustness]) -> str:
    """Return in words which system loses least; nothing if no disturbance is common to all."""
    parts = set(common_parts(records))
    means = {
        name: mean_drop(drops_by_kind(one, parts)) for name, one in zip(system_names(records), records, strict=True)
    }
    name = min(means, key=lambda name: (math.isnan(means[name]), means[name]))
    return f"{name} loses least: {_percent(means[name])} % in the mean over kinds." if parts else ""


def part_cells(records: Sequence[Robustness]) -> Cells:
    """Return head and rows: the loss of RayIoU of every system to every disturbance."""
    names = list(dict.fromkeys(part.part for record in records for part in record.disturbed))
    rows = []
    for name in names:
        found = [next((part for part in record.disturbed if part.part == name), None) for record in records]
        rows.append([name, *(_drop(part, record) for part, record in zip(found, records, strict=True))])
    return [f"loss of {VOXEL_RAYIOU}", *system_names(records)], rows


def report_parts(records: Sequence[Robustness]) -> list[Part]:
    """Return for each setting a table of mean losses, with where the tests come from, and one of all disturbances."""
    parts = []
    for place, group in enumerate(comparable(records)):
        name = f"robustness-{place}" if place else "robustness"
        remarks = [NOTE, verdict(group), *map(facts_line, group, system_names(group))]
        parts.append(Part(name, TITLE, " ".join(filter(None, remarks)), relative_cells(group)))
        parts.append(Part(f"{name}-parts", f"{TITLE}: every disturbance", PARTS_NOTE, part_cells(group)))
    return parts


def facts_line(record: Robustness, name: str) -> str:
    """Return where the record of a system of this name comes from."""
    facts, base = record.facts, record.undisturbed
    text = f"{name}: {len(base.scenes)} scenes, {base.frames} frames, disturbances of seed {facts.get('seed')}"
    text += f"; `{facts.get('command')}`, commit {facts.get('commit')}, {facts.get('machine')}."
    return text + "".join(f" Left out: {line}." for line in facts.get("left out", []))


def page_parts(records: Sequence[Robustness], steps: str, names: Mapping[str, str]) -> list[Part]:
    """Return a table of the systems trained for a number of steps, and one of all others, means over their seeds.

    Systems that were tested on other scenes have tables of their own.
    """
    parts = []
    for place, group in enumerate(comparable(records)):
        elsewhere = " on other test scenes" if place else ""
        trained = [record.training.partition(" ")[0] for record in group]
        for same in (True, False):
            own = {k: record for k, record in enumerate(group) if (trained[k] == steps) == same}
            rows = {k: HASH.sub("", record.system) for k, record in own.items()}
            titles = [named(row if same or not trained[k] else f"{row}@{trained[k]}", names) for k, row in rows.items()]
            title = f"Trained for {steps} steps" if same else "Trained for other numbers of steps"
            if own:
                parts.append(Part("robustness", title + elsewhere, "", relative_cells(list(own.values()), titles)))
    return parts


def robustness_csv(records: Sequence[Robustness], names: Mapping[str, str]) -> str:
    """Return CSV with a line for each system and disturbance: every score, its loss and the standard error of that.

    Where the test comes from stands in the first line of each system, the undisturbed one.
    """
    keys = list(dict.fromkeys(key for record in records for key in record.undisturbed.scores))
    titles = [SCORES.get(key) or f"{VOXEL_RAYIOU} within {key.removeprefix(WITHIN)}" for key in keys]
    facts = {"seed": "seed of the disturbances", "command": "command", "commit": "commit", "machine": "machine"}
    head = ["system", "method", "training", "kind of disturbance", "disturbance", "scenes", "frames", "seconds"]
    head += [f"{title}{column}" for title in titles for column in ("", ", loss", ", standard error over scenes")]
    head += [f"relative loss of {VOXEL_RAYIOU}", *facts.values(), "left out"]
    lines = []
    for record in records:
        row = HASH.sub("", record.system)
        for part in record.parts:
            cells = [record.system, names.get(row, row), record.training, part.group, part.part]
            cells += [len(part.scenes), part.frames, f"{part.seconds:.0f}"]
            drops = [(part.scores.get(key), *drop_of(part, record.undisturbed, key)) for key in keys]
            cells += [exact(value) for each in drops for value in each]
            cells.append(exact(relative_drop(part, record.undisturbed)))
            source = [*(record.facts.get(key, "") for key in facts), "; ".join(record.facts.get("left out", []))]
            lines.append([*cells, *(source if part is record.undisturbed else [""] * len(source))])
    return csv_text(head, lines)


def _drop(part: PartScores | None, record: Robustness, key: str = "rayiou") -> str:
    if part is None:
        return "–"
    drop = drop_of(part, record.undisturbed, key)
    return number(drop.value) + ("" if math.isnan(drop.error) else f" ({drop.error:.3f})")


def _percent(fraction: float) -> str:
    return "–" if math.isnan(fraction) else f"{100 * fraction:.1f}"


def _least_bold(drops: Sequence[float]) -> list[str]:
    known = [drop for drop in drops if not math.isnan(drop)]
    least = min(known, default=math.nan) if len(drops) > 1 else math.nan
    return [f"**{_percent(drop)}**" if drop == least else _percent(drop) for drop in drops]
