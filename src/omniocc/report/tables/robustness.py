"""What breaks each system: relative drops by kind of disturbance, every part with its standard error, nested ranges."""

import math
from collections.abc import Sequence

import numpy as np

from omniocc.report.runs import HASH
from omniocc.run.robustness import WITHIN, PartScores, Robustness, drop_of, drops_by_kind
from omniocc.run.table import Cells, in_columns, markdown, number

TITLE = "What breaks them"
NOTE = (
    "RayIoU of the same test scenes with something wrong, part by part. A drop is the score without disturbance minus "
    "that with it, ± the standard error over scenes (jackknife). A relative drop is in percent of the system's own "
    "undisturbed score; a system that scores little has little to lose, so the last row has the RayIoU after the mean "
    "relative drop. In the table of one system the row "
    "'undisturbed' has scores where all others have drops; the columns 'within' are of RayIoU up to this distance. "
    "s: wall-clock seconds of prediction and scores."
)
SCORES = {"rayiou": "RayIoU", "lidar/rayiou": "LiDAR", "voxel/iou": "IoU", "voxel/miou": "mIoU"}


def names_of(records: Sequence[Robustness]) -> list[str]:
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


def relative_cells(records: Sequence[Robustness]) -> Cells:
    """Return head and rows: the mean relative drop by kind of disturbance, the least in bold, then their mean.

    The first row is the undisturbed RayIoU, the last the RayIoU after the mean relative drop.
    """
    drops = [drops_by_kind(record, set(common_parts(records))) for record in records]
    undisturbed = [record.undisturbed.scores.get("rayiou", math.nan) for record in records]
    rows = [["undisturbed RayIoU", *map(number, undisturbed)]]
    rows += [[group, *_least_bold([one[group] for one in drops])] for group in drops[0]]
    if drops[0]:
        means = [mean_drop(one) for one in drops]
        left = [score * (1 - mean) for score, mean in zip(undisturbed, means, strict=True)]
        rows += [["mean of all kinds", *_least_bold(means)], ["RayIoU after it", *map(number, left)]]
    return ["relative drop of RayIoU, %", *names_of(records)], rows


def mean_drop(drops: dict[str, float]) -> float:
    """Return the mean over kinds of disturbances, which count equally."""
    return float(np.nanmean(list(drops.values()))) if drops else math.nan


def verdict(records: Sequence[Robustness]) -> str:
    """Return in words which system loses least, and to what; nothing if no disturbance is common to all."""
    parts = set(common_parts(records))
    drops = {name: drops_by_kind(one, parts) for name, one in zip(names_of(records), records, strict=True)}
    if not all(drops.values()):
        return ""
    order = sorted(drops, key=lambda name: mean_drop(drops[name]))
    lines = []
    for name in order:
        kinds = sorted(drops[name], key=lambda group: -drops[name][group])
        worst = kinds[:-1][:3] or kinds
        most = ", ".join(f"{group} ({_percent(drops[name][group])} %)" for group in worst)
        lines.append(
            f"{name} loses {_percent(mean_drop(drops[name]))} % in the mean over kinds, most to {most}, "
            f"least to {kinds[-1]} ({_percent(drops[name][kinds[-1]])} %)."
        )
    if len(order) == 1:
        return lines[0]
    wins = {name: [g for g in drops[name] if min(order, key=lambda n: drops[n][g]) == name] for name in order}
    least = "; ".join(f"{name}: {', '.join(groups)}" for name, groups in wins.items() if groups)
    return " ".join([f"{order[0]} loses least of all.", *lines, f"Kinds to which each loses least: {least}."])


def part_cells(records: Sequence[Robustness]) -> Cells:
    """Return head and rows: the drop of RayIoU of every system to every disturbance."""
    names = list(dict.fromkeys(part.part for record in records for part in record.disturbed))
    rows = []
    for name in names:
        found = [next((part for part in record.disturbed if part.part == name), None) for record in records]
        rows.append([name, *(_drop(part, record) for part, record in zip(found, records, strict=True))])
    return ["drop of RayIoU", *names_of(records)], rows


def score_cells(record: Robustness, name: str) -> Cells:
    """Return head and rows of a system of this name: RayIoU, drops of all scores and of RayIoU within nested ranges."""
    base = record.undisturbed
    within = [key for key in base.scores if key.startswith(WITHIN)]
    shown = {key: title for key, title in SCORES.items() if key in base.scores}
    titles = [f"within {key.removeprefix(WITHIN).replace('m', ' m')}" for key in within]
    head = [name, "RayIoU", *(f"{title}, drop" for title in shown.values()), *titles, "frames", "s"]
    rows = []
    for part in record.parts:
        drops = [_drop(part, record, key) if part is not base else number(base.scores[key]) for key in shown]
        near = [
            number(base.scores[key] if part is base else drop_of(part, base, key).value) for key in within
        ]  # fmt: skip
        cells = [number(part.scores.get("rayiou")), *drops, *near, str(part.frames), f"{part.seconds:.0f}"]
        rows.append([part.part, *cells])
    return head, rows


def facts_line(record: Robustness, name: str) -> str:
    """Return where the record of a system of this name comes from."""
    facts, base = record.facts, record.undisturbed
    text = f"{name}: {len(base.scenes)} scenes, {base.frames} frames, disturbances of seed {facts.get('seed')}"
    text += f"; `{facts.get('command')}`, commit {facts.get('commit')}, {facts.get('machine')}."
    return text + "".join(f" Left out: {line}." for line in facts.get("left out", []))


def robustness_markdown(records: Sequence[Robustness]) -> str:
    """Return all tables under a heading of level 2."""
    parts = [f"## {TITLE}", NOTE]
    for group in comparable(records):
        parts += [verdict(group), markdown(*relative_cells(group)), markdown(*part_cells(group))]
        for record, name in zip(group, names_of(group), strict=True):
            parts += [markdown(*score_cells(record, name)), facts_line(record, name)]
    return "\n\n".join(part.strip() for part in parts if part) + "\n"


def robustness_text(records: Sequence[Robustness]) -> str:
    """Return the comparison for a terminal."""
    groups = comparable(records)
    tables = [
        table for group in groups for table in (in_columns(*part_cells(group)), in_columns(*relative_cells(group)))
    ]
    return "\n\n".join([*tables, *filter(None, map(verdict, groups))])


def _drop(part: PartScores | None, record: Robustness, key: str = "rayiou") -> str:
    if part is None:
        return "–"
    drop = drop_of(part, record.undisturbed, key)
    return number(drop.value) + ("" if math.isnan(drop.error) else f" ± {drop.error:.3f}")


def _percent(fraction: float) -> str:
    return "–" if math.isnan(fraction) else f"{100 * fraction:.1f}"


def _least_bold(drops: Sequence[float]) -> list[str]:
    known = [drop for drop in drops if not math.isnan(drop)]
    least = min(known, default=math.nan) if len(drops) > 1 else math.nan
    return [f"**{_percent(drop)}**" if drop == least else _percent(drop) for drop in drops]
