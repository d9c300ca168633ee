"""Training budget and cost of each row, so that equal budgets can be checked."""

from collections.abc import Callable, Iterator, Mapping, Sequence

from omniocc.report.runs import FinishedRun
from omniocc.run.cost import GFLOP, PARAMETERS, PEAK
from omniocc.run.results import EARLIER_MINUTES, MINUTES
from omniocc.run.table import Cells

STAGES = ("depth", "sketch", "occupancy")
HEAD = ["row", "M parameters", "GFLOP a frame", "steps of depth", "of the sketch", "of the model", "in all"]
HEAD += ["samples a step", "minutes", "in all", "peak MiB"]
NOTE = (
    "Parameters and operations count all networks of a row: the last one, which gives every voxel its class, and those "
    "of depth and sketch before it. Memory and the first column of minutes are of training the last one alone. Rows "
    "with a learned sketch share the training of depth and sketch; 'in all' counts it in every row. Minutes are means "
    "over seeds that ran beside other work, so that they differ by more than their rows do: compare operations."
)


def budget_cells(rows: Mapping[str, Sequence[FinishedRun]]) -> Cells:
    """Return the head and a line for each row; a dash where its runs have no record.

    Minutes are means over seeds, parameters, operations and memory maxima.
    """
    return HEAD, [[row, *_budget(runs)] for row, runs in rows.items()]


def _budget(runs: Sequence[FinishedRun]) -> Iterator[str]:
    steps = runs[0].facts.get("stages", {})
    yield _over_seeds(runs, PARAMETERS, "{:.2f}", max)
    yield _over_seeds(runs, GFLOP, "{:.3g}", max)
    yield from (str(steps.get(stage, "–")) for stage in STAGES)
    yield str(sum(steps.values())) if steps else "–"
    yield str(runs[0].config.get("data", {}).get("batch_size", "–"))
    yield _over_seeds(runs, MINUTES, "{:.1f}", lambda values: sum(values) / len(values))
    known = [minutes_in_all(run) for run in runs if run.facts.get(MINUTES) is not None]
    yield f"{sum(known) / len(known):.1f}" if known else "–"
    yield _over_seeds(runs, PEAK, "{:.0f}", max)


def minutes_in_all(run: FinishedRun) -> float:
    """Return the minutes of all stages of a run; 0 for what it did not record."""
    return float(run.facts.get(MINUTES) or 0.0) + float(run.facts.get(EARLIER_MINUTES) or 0.0)


def _over_seeds(runs: Sequence[FinishedRun], key: str, form: str, reduce: Callable[[list[float]], float]) -> str:
    values = [float(run.facts[key]) for run in runs if run.facts.get(key) is not None]
    return form.format(reduce(values)) if values else "–"
