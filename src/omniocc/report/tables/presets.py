"""Runs of other presets than that of the tables."""

from collections.abc import Sequence

from omniocc.report.runs import FinishedRun
from omniocc.report.tables.overview import overview_keys
from omniocc.run.cost import PEAK
from omniocc.run.results import EARLIER_MINUTES, MINUTES
from omniocc.run.table import markdown, number

TITLE = "Other presets"
NOTE = (
    "Runs of other presets than that of the tables; no claim is tested by them. Steps: of depth, sketch and occupancy. "
    "Minutes: of training, all stages. What a preset is: [the data](../dataset.md#at-a-glance); how these runs came to "
    "be: [a GPU](../how_to/gpu.md); their commands: [the runs](runs.md)."
)
STAGES = ("depth", "sketch", "occupancy")


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
    titles = ["RayIoU", *(key.rpartition("_")[2] for key in keys[1:-3]), "RayIoU, LiDAR", "mIoU", "IoU"]
    lines = [[run.name, *_facts(run), *(number(run.metrics.get(key)) for key in keys)] for run in runs]
    head = ["run", "seed", "steps", "minutes", "MiB, peak", *titles]
    return f"### preset={preset}, data {data[:8]}\n\n{markdown(head, lines).rstrip()}"


def _facts(run: FinishedRun) -> list[str]:
    """Return seed, steps of all stages, minutes of training and the most memory held, in words."""
    steps = run.facts.get("stages", {})
    minutes = float(run.facts.get(MINUTES) or 0) + float(run.facts.get(EARLIER_MINUTES) or 0)
    of_stages = "/".join(str(steps.get(stage, "–")) for stage in STAGES)
    return [str(run.facts.get("seed", "–")), of_stages, f"{minutes:.1f}", str(run.facts.get(PEAK, "–"))]
