"""Training budget and cost of each row, so that equal budgets can be checked."""

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence

from omniocc.report.runs import FinishedRun
from omniocc.report.tables.formats import csv_text, exact
from omniocc.report.tables.names import named
from omniocc.runs.cost import GFLOP, PARAMETERS, PEAK
from omniocc.runs.machine import MACHINE
from omniocc.runs.results import EARLIER_MINUTES, MINUTES
from omniocc.runs.table import SURFACE_RAYIOU, VOXEL_RAYIOU, Cells, band_keys, number

Rows = Mapping[str, Sequence[FinishedRun]]
STAGES = ("depth", "sketch", "occupancy")
HEAD = ["Method", "M parameters", "GFLOP a frame", "Steps of depth", "Steps of sketch", "Steps of occupancy"]
HEAD += ["Steps in all", "Samples a step", "Minutes of occupancy", "Minutes in all", "Peak MiB"]
TITLE = "Budget"
NOTE = (
    "The depth network estimates ranges. The sketch network selects candidate voxels. The occupancy network is "
    "trained last and gives every voxel a class. Parameters and operations are the sum over all networks of the "
    "model. Peak memory is measured during occupancy training. "
    "Minutes in all add the training of depth and sketch, also where several models use the same trained ones. "
    "Minutes are means over seeds."
)
OF_MANY = " Compare operations rather than minutes or MiB, which depend on the machine."


def note(rows: Mapping[str, Sequence[FinishedRun]]) -> str:
    """Return what the columns are, and on which machines the runs were made."""
    once = {run.name: run for runs in rows.values() for run in runs}.values()
    machines = Counter(str(run.facts.get(MACHINE, "not recorded")) for run in once)
    counts = "; ".join(
        f"{name} ({count} runs)" if count > 1 else f"{name} (1 run)" for name, count in machines.most_common()
    )
    return f"{NOTE} Machines: {counts}.{OF_MANY * (len(machines) > 1)}"


def budget_cells(rows: Mapping[str, Sequence[FinishedRun]], names: Mapping[str, str]) -> Cells:
    """Return the head and a line for each row, by its name for readers; a dash where its runs have no record.

    Minutes are means over seeds, parameters, operations and memory maxima.
    """
    return HEAD, [[named(row, names), *_budget(runs)] for row, runs in rows.items()]


def _budget(runs: Sequence[FinishedRun]) -> Iterator[str]:
    steps = runs[0].facts.get("stages", {})
    yield _over_seeds(runs, PARAMETERS, "{:.2f}", max)
    yield _over_seeds(runs, GFLOP, "{:.3g}", max)
    yield from (str(steps.get(stage, "–")) for stage in STAGES)
    yield str(sum(steps.values())) if steps else "–"
    yield samples_a_step(runs[0])
    yield _over_seeds(runs, MINUTES, "{:.1f}", lambda values: sum(values) / len(values))
    known = [minutes_in_all(run) for run in runs if run.facts.get(MINUTES) is not None]
    yield f"{sum(known) / len(known):.1f}" if known else "–"
    yield _over_seeds(runs, PEAK, "{:.0f}", max)


def minutes_in_all(run: FinishedRun) -> float:
    """Return the minutes of all stages of a run; 0 for what it did not record."""
    return float(run.facts.get(MINUTES) or 0.0) + float(run.facts.get(EARLIER_MINUTES) or 0.0)


def samples_a_step(run: FinishedRun) -> str:
    """Return the samples of a step of the last stage; runs of older versions name them with the data."""
    recipe = (run.config.get("stages") or {}).get("occupancy")
    known = recipe if isinstance(recipe, dict) else run.config.get("data") or {}
    return str(known.get("batch_size", "–"))


def steps_of_stages(run: FinishedRun) -> str:
    """Return the steps of depth, sketch and occupancy, for example `1600/500/1000`; a dash for a stage it lacks."""
    steps = run.facts.get("stages", {})
    return "/".join(str(steps.get(stage, "–")) for stage in STAGES)


def _over_seeds(runs: Sequence[FinishedRun], key: str, form: str, reduce: Callable[[list[float]], float]) -> str:
    values = [float(run.facts[key]) for run in runs if run.facts.get(key) is not None]
    return form.format(reduce(values)) if values else "–"


FACTS = {
    "seed": "seed",
    "preset": "preset",
    "data": "fingerprint of the data",
    "steps": "steps",
    MINUTES: "minutes",
    EARLIER_MINUTES: "minutes of depth and sketch",
    PEAK: "peak memory, MiB",
    "commit": "commit",
    MACHINE: "machine",
}
"""Titles of recorded facts."""


def overview_keys(runs: Sequence[FinishedRun]) -> list[str]:
    """Return the keys of the figures in `table_of_runs`."""
    bands = band_keys(runs[0].metrics)
    return [f"test/{key}" for key in ("rayiou", *bands, "lidar/rayiou", "voxel/miou")]


def table_of_runs(runs: Sequence[FinishedRun]) -> Cells:
    """Return head and rows: run, seed, steps, voxel RayIoU, its distance bands, surface RayIoU, mIoU."""
    names = [band.removeprefix("rayiou_") for band in band_keys(runs[0].metrics)]
    head = ["run", "seed", "steps", VOXEL_RAYIOU, *names, SURFACE_RAYIOU, "mIoU"]
    rows = []
    for run in runs:
        facts = [str(run.facts.get(key, "–")) for key in ("seed", "steps")]
        rows.append([run.name, *facts, *(number(run.metrics.get(key)) for key in overview_keys(runs))])
    return head, rows


def records(runs: Sequence[FinishedRun]) -> str:
    """Return CSV of how runs were made and what they scored, by name."""
    bands = list(dict.fromkeys(key for run in runs for key in band_keys(run.metrics)))
    scores = {"rayiou": VOXEL_RAYIOU, **{key: f"{VOXEL_RAYIOU}, {key.partition('_')[2]}" for key in bands}}
    scores |= {"lidar/rayiou": SURFACE_RAYIOU, "voxel/iou": "IoU", "voxel/miou": "mIoU"}
    lines = []
    for run in sorted(runs, key=lambda run: run.name):
        facts = [str(run.facts.get(key, "")) for key in FACTS]
        known = [exact(run.metrics.get(f"test/{key}")) for key in scores]
        lines.append([run.name, run.row, *facts, steps_of_stages(run), *known, run.command or ""])
    head = ["run", "row", *FACTS.values(), "steps of depth, sketch and occupancy", *scores.values(), "command"]
    return csv_text(head, lines)
