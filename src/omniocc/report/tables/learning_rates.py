"""The learning rate of each system, chosen on validation scenes among equally many."""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from omniocc.report.runs import FinishedRun
from omniocc.report.selection import given_values
from omniocc.report.tables.formats import csv_text
from omniocc.report.tables.paper import SPREAD, figure_of, spread_cells

SCORE = "val/rayiou"
RATE_KEYS = ("optimizer.learning_rate", "preset.stages.occupancy.learning_rate")
"""Key of the learning rate of a run, and of the preset's value, which it has by default."""


class TunedSystem(NamedTuple):
    """A system and its runs by learning rate; every rate has runs with the same seeds."""

    name: str
    runs: Mapping[float, Sequence[FinishedRun]]

    @property
    def best_rate(self) -> float:
        """Return the rate with the highest mean score; of equal ones the lowest."""
        means = {rate: figure.mean for rate, runs in self.runs.items() if (figure := figure_of(runs, SCORE))}
        return max(sorted(means), key=lambda rate: means[rate])


def tuned_systems(runs: Sequence[FinishedRun]) -> list[TunedSystem]:
    """Return every configuration that was trained at two learning rates or more, in the order of names.

    Runs are of one system if they differ in nothing but rate, name and seed. The system's name is what the names of its
    runs have in common.
    """
    groups: dict[str, dict[float, dict[Any, FinishedRun]]] = {}
    for run in sorted(runs, key=lambda run: run.name):
        settings = given_values(run.config)
        rate = settings.get(RATE_KEYS[0])
        if rate is not None and not math.isnan(run.metrics.get(SCORE, math.nan)):
            rest = {key: value for key, value in settings.items() if key not in RATE_KEYS}
            key = repr([sorted(rest.items()), run.facts.get("data")])
            groups.setdefault(key, {}).setdefault(float(rate), {})[run.facts.get("seed")] = run
    found = []
    for rates in groups.values():
        seeds = set.intersection(*(set(by_seed) for by_seed in rates.values()))
        if len(rates) > 1 and seeds:
            by_rate = {rate: [rates[rate][seed] for seed in sorted(seeds)] for rate in sorted(rates)}
            name = common_name([run.row for same_rate in by_rate.values() for run in same_rate])
            found.append(TunedSystem(name, by_rate))
    return sorted(found, key=lambda system: system.name)


def common_name(names: Sequence[str]) -> str:
    """Return the words between underscores that all names have at the same position, or else the first name."""
    words = [name.split("_") for name in names]
    same = [column[0] for column in zip(*words, strict=False) if len(set(column)) == 1]
    return "_".join(same) or names[0]


def learning_rates_csv(runs: Sequence[FinishedRun]) -> str:
    """Return CSV with a line for each system and rate; empty if no system was trained at several rates.

    Only the seeds that all rates of a system share count, so that every rate has the same number of tries.
    """
    head = ["system", "learning rate", *(f"validation voxel RayIoU, {column}" for column in SPREAD[:-1]), "seeds"]
    lines = [
        [tuned.name, f"{rate:g}", *spread_cells(figure_of(tried, SCORE)), "yes" if rate == tuned.best_rate else "no"]
        for tuned in tuned_systems(runs)
        for rate, tried in tuned.runs.items()
    ]
    return csv_text([*head, "chosen"], lines) if lines else ""
