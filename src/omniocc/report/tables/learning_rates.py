"""The learning rate of each system, chosen on validation scenes among equally many."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from omniocc.report.runs import FinishedRun
from omniocc.report.selection import given_values
from omniocc.report.tables.formats import csv_text
from omniocc.report.tables.paper import SPREAD, figure_of, spread_cells

SCORE = "val/rayiou"
KEYS = ("optimizer.learning_rate", "preset.stages.occupancy.learning_rate")


class Tried(NamedTuple):
    """A system with all learning rates that were tried; `runs[rate]` have the same seeds for every rate."""

    name: str
    runs: Mapping[float, Sequence[FinishedRun]]

    @property
    def chosen(self) -> float:
        """Return the rate with the highest mean; of equal ones the lowest."""
        means = {rate: figure.mean for rate, runs in self.runs.items() if (figure := figure_of(runs, SCORE))}
        return max(sorted(means), key=lambda rate: means[rate])


def tried_rates(runs: Sequence[FinishedRun]) -> list[Tried]:
    """Return every configuration that was trained at two learning rates or more, in the order of names.

    Runs belong together if they differ in nothing but the rate, name and seed; the name is the beginning that the names
    of all have in common.
    """
    groups: dict[str, dict[float, dict[Any, FinishedRun]]] = {}
    for run in sorted(runs, key=lambda run: run.name):
        settings = given_values(run.config)
        rate = settings.get(KEYS[0])
        if rate is not None and SCORE in run.metrics:
            rest = {key: value for key, value in settings.items() if key not in KEYS}
            key = repr([sorted(rest.items()), run.facts.get("data")])
            groups.setdefault(key, {}).setdefault(float(rate), {})[run.facts.get("seed")] = run
    found = []
    for rates in groups.values():
        seeds = set.intersection(*(set(by_seed) for by_seed in rates.values()))
        if len(rates) > 1 and seeds:
            chosen = {rate: [rates[rate][seed] for seed in sorted(seeds)] for rate in sorted(rates)}
            found.append(Tried(common_name([run.row for runs in chosen.values() for run in runs]), chosen))
    return sorted(found, key=lambda tried: tried.name)


def common_name(rows: Sequence[str]) -> str:
    """Return what the names of rows have in common at their beginning, in whole words."""
    words = [row.split("_") for row in rows]
    same = [first[0] for first in zip(*words, strict=False) if len(set(first)) == 1]
    return "_".join(same) or rows[0]


def learning_rates(runs: Sequence[FinishedRun]) -> str:
    """Return CSV with a line for each system and rate; empty if no system was trained at several rates.

    Only seeds that all rates of a system have count, so that every rate has the same number of tries.
    """
    tried = tried_rates(runs)
    head = ["system", "learning rate", *(f"validation voxel RayIoU, {column}" for column in SPREAD[:-1]), "seeds"]
    lines = [
        [system.name, f"{rate:g}", *spread_cells(figure_of(found, SCORE)), "yes" if rate == system.chosen else "no"]
        for system in tried
        for rate, found in system.runs.items()
    ]
    return csv_text([*head, "chosen"], lines) if lines else ""
