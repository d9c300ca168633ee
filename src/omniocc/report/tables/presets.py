"""Runs of other presets than that of the tables."""

from collections.abc import Sequence

from omniocc.report.runs import FinishedRun
from omniocc.report.tables.budget import minutes_in_all, steps_of_stages
from omniocc.report.tables.overview import overview_keys, overview_titles
from omniocc.run.cost import PEAK
from omniocc.run.table import markdown, number

TITLE = "Other presets"
NOTE = (
    "Runs of other presets than that of the tables; no claim is tested by them. Steps: of depth, sketch and occupancy. "
    "Minutes: of training, all stages. What a preset is: [the data](../dataset.md#at-a-glance); how these runs came to "
    "be: [a GPU](../how_to/gpu.md); their commands: [the runs](runs.md)."
)


def presets_chapter(settings: Sequence[Sequence[FinishedRun]]) -> str:
    """Return a table for each preset, number of steps and dataset; empty without any.

    Args:
        settings: runs of one setting each.
    """
    if not settings:
        return ""
    return "\n\n".join([f"## {TITLE}", NOTE, *map(_of_setting, settings)])


def _of_setting(runs: Sequence[FinishedRun]) -> str:
    preset, _, data = runs[0].setting
    keys = [*overview_keys(runs), "test/voxel/iou"]
    lines = [[run.name, *_facts(run), *(number(run.metrics.get(key)) for key in keys)] for run in runs]
    head = ["run", "seed", "steps", "minutes", "MiB, peak", *overview_titles(runs), "IoU"]
    return f"### preset={preset}, data {data[:8]}\n\n{markdown(head, lines).rstrip()}"


def _facts(run: FinishedRun) -> list[str]:
    """Return seed, steps of all stages, minutes of training and the most memory held, in words."""
    seed, peak = (str(run.facts.get(key, "–")) for key in ("seed", PEAK))
    return [seed, steps_of_stages(run), f"{minutes_in_all(run):.1f}", peak]
