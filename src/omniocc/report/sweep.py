"""The content of a report: comparable runs with the paper's tables, apart by setting."""

import functools
import os
import re
import sys
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

from omegaconf import OmegaConf

from omniocc.config import compose_plain
from omniocc.errors import UserError
from omniocc.io import read_yaml
from omniocc.progress import Progress
from omniocc.report.datasets import (
    DatasetTable,
    facts_of_scenes,
    is_dataset_table,
    load_dataset_table,
    with_records,
)
from omniocc.report.runs import HASH, FinishedRun, read_runs
from omniocc.report.selection import (
    by_row,
    comparable,
    counted_otherwise,
    given_values,
    mixtures,
    otherwise_text,
    settings_of,
)
from omniocc.report.tables.claims import Judged, Name, verdicts_of
from omniocc.report.tables.paper import PaperTable, is_table, load_table
from omniocc.report.tables.power import SeedStd, load_seed_stds
from omniocc.runs.curves import read_curve
from omniocc.runs.results import METRICS
from omniocc.runs.robustness import Robustness, read_robustness
from omniocc.runs.rows import FOLDER, known_rows, table_files


def assign_rows(
    runs: Sequence[FinishedRun], conf: Path, rows: Sequence[str], known: Mapping[str, Sequence[str]]
) -> list[FinishedRun]:
    """Return the runs, each with its row.

    A run with the name of a row belongs to it. Any other run (`name=demo`) belongs to the first row whose
    configuration, composed with the run's preset and no other override, equals the run's, or else to its own row.

    Args:
        runs: finished runs.
        conf: folder of the configuration.
        rows: names of the tables' rows, whose order decides, after those with a file of their own; those that are not
            in `known` are found only by name.
        known: overrides of rows, of `known_rows`.

    Raises:
        ConfigError: when a row cannot be composed.
    """
    named = {*rows, *known}
    tried = [row for row in dict.fromkeys([*rows, *sorted(known)]) if row in known]
    tried.sort(key=lambda row: list(known[row]) != [f"+{FOLDER}={row}"])
    stated = {row: _stated(conf, known[row]) for row in tried}
    roots = {row: _roots(conf, known[row]) for row in tried}

    @functools.cache
    def common(preset: str) -> dict[str, Any]:
        return _literal(given_values(compose_plain(conf, "train", [f"preset={preset}"], resolve=False)))

    @functools.cache
    def composed(preset: str, row: str) -> dict:
        return given_values(compose_plain(conf, "train", [f"preset={preset}", *known[row]]))

    def with_row(run: FinishedRun) -> FinishedRun:
        preset = _preset(run)
        config = given_values(run.config)
        # composing a row takes .2 s, so first left out are those that state another value, or do not change one that
        # the preset has and the run has not
        likely = (row for row in tried if all(config.get(key, value) == value for key, value in stated[row].items()))
        others = {key.partition(".")[0] for key, value in common(preset).items() if config.get(key) != value}
        likely = (row for row in likely if EVERY in roots[row] or others <= roots[row])
        return run._replace(same_as=next((row for row in likely if composed(preset, row) == config), None))

    found = list(runs)
    presets = {path.stem for path in (conf / "preset").glob("*.yaml")}
    unnamed = [index for index, run in enumerate(runs) if run.row not in named and _preset(run) in presets]
    if not unnamed:
        return found
    with Progress("comparing runs of other names with the rows", len(unnamed), unit="runs") as progress:
        for index in unnamed:
            found[index] = with_row(runs[index])
            progress.advance()
    return found


def _preset(run: FinishedRun) -> str:
    return str(run.config.get("preset", {}).get("name"))


def _stated(conf: Path, words: Sequence[str]) -> dict[str, Any]:
    """Return numbers and words that a row states itself, in its overrides or its file, by dotted key."""
    stated: dict[str, Any] = {}
    for key, _, value in (word.partition("=") for word in words):
        if key == f"+{FOLDER}":
            stated |= given_values(read_yaml(conf / FOLDER / f"{value}.yaml") or {})
        elif "/" not in key and not (conf / key).is_dir():
            stated |= given_values(OmegaConf.to_container(OmegaConf.from_dotlist([f"{key}={value}"])))  # type: ignore
    return _literal(stated)


def _literal(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return the numbers and words among values, without references to others."""
    kinds = bool | int | float | str
    return {key: value for key, value in values.items() if isinstance(value, kinds) and "${" not in str(value)}


def _roots(conf: Path, words: Iterable[str]) -> set[str]:
    """Return the root keys below which overrides, and the options that they choose, set values.

    `EVERY` is among them where an option is not of `conf`, since its file is not read.
    """
    found: set[str] = set()
    for word in words:
        key, _, option = word.lstrip("+~").partition("=")
        group, _, package = key.partition("@")
        file = conf / group / f"{option}.yaml"
        content = (read_yaml(file) or {}) if file.is_file() else {}
        if not file.is_file() and ("/" in group or (conf / group).is_dir() or word.startswith("+")):
            found.add(EVERY)
        head = PACKAGE.match(file.read_text()) if content else None
        for place in filter(None, (group, package, head and head[1])):  # which of them holds depends on the options
            root = re.split(r"[./]", place.removeprefix("_global_."))[0]
            found |= content.keys() if root == "_global_" else {EVERY if root.startswith("_") else root}
        for entry in content.get("defaults", ()):
            chosen = entry if isinstance(entry, dict) else {} if entry == "_self_" else {f"/{group}": entry}
            for name, value in chosen.items():
                *_, name = name.split()  # without `override`
                found |= _roots(conf, [f"{name[1:]}={value}" if name[0] == "/" else f"{group}/{name}={value}"])
    return found


PACKAGE = re.compile(r"# @package (\S+)")
"""Line of an option's file that names the key below which its values are."""
EVERY = "*"
"""Stands for all root keys."""
NAMED = 12
"""Most rows that a remark names."""
POWER = "power.yaml"
"""File of standard deviations between seeds, beside the tables."""


class Sweep(NamedTuple):
    """Comparable runs and the paper's tables.

    Attributes:
        runs: comparable runs, by falling RayIoU.
        rows: runs of each row, in the order of the tables, then those of rows that are in no table.
        remark: on common settings of the runs, and on runs that are left out.
        data: scenes and frames of the dataset; empty if it is recorded.
        tables: tables of methods.
        datasets: tables of datasets.
        unfinished: runs that have begun and not finished, with the last step recorded.
        lengths: runs of all settings of the same preset by `row@steps`, which rows of tables may name; none where
            another dataset of the preset has more runs.
        longer: the sweeps of the same preset and data with more steps, fewest first.
        seed_stds: given standard deviations between seeds, for which power is computed.
        robustness: tests under disturbances of these runs; the first sweep of a report has those of all sweeps, and
            of files that are no runs.
    """

    runs: list[FinishedRun]
    rows: Mapping[str, Sequence[FinishedRun]]
    remark: str
    data: str
    tables: Sequence[PaperTable]
    datasets: Sequence[DatasetTable]
    unfinished: Sequence[str] = ()
    lengths: Mapping[str, Sequence[FinishedRun]] = MappingProxyType({})
    longer: "Sequence[Sweep]" = ()
    seed_stds: Sequence[SeedStd] = ()
    robustness: Sequence[Robustness] = ()

    @property
    def setting(self) -> str:
        """Return preset, steps and data in a word, for the name of a folder."""
        preset, steps, data = self.runs[0].setting
        return f"{preset}-{steps}-{data[:8]}"

    @property
    def table_rows(self) -> Mapping[str, Sequence[FinishedRun]]:
        """Return the runs of everything that a row of a table may name."""
        return {**self.lengths, **self.rows}

    @property
    def claims(self) -> dict[Name, Judged]:
        """Return the claims of all tables with their verdicts."""
        return verdicts_of(self.tables, self.table_rows)

    @property
    def not_run(self) -> list[str]:
        """Return the rows of the tables without a run."""
        rows = dict.fromkeys(row.run for table in self.tables for row in table.rows)
        return [row for row in rows if row not in self.table_rows]

    @property
    def remarks(self) -> list[str]:
        """Return sentences on the runs of the report, and on those left out, missing or unfinished."""
        own = list(self.rows.values())
        others = {name: runs for name, runs in self.lengths.items() if not any(runs is rows for rows in own)}
        absent = self.not_run
        named = ", ".join(absent) if len(absent) <= NAMED else f"{len(absent)} rows of the tables"
        missing = [f"Not run: {named}."] if absent else []
        begun = [f"Begun, not finished: {', '.join(self.unfinished)}."] if self.unfinished else []
        return [self.remark, *mixtures(dict(self.rows) | others), *missing, *begun]


def read_sweeps(runs: Path, tables: Path, conf: Path, preset: str | None) -> list[Sweep]:
    """Return the finished runs of a folder with the tables of another, apart by preset, steps and data.

    The setting that most runs have is the first. The folder `conf` has the rows. A preset leaves out the others. The
    folders `conf/sweep` of the packages in `OMNIOCC_PACKAGES` have tables too.

    Raises:
        UserError: when there is no run, none of that preset, or a table or row is broken.
    """
    paths = table_files(tables)
    found = sorted((load_table(path) for path in paths if is_table(path)), key=lambda table: table.number or len(paths))
    first = list(dict.fromkeys(["ours", *(row.run for table in found for row in table.rows)]))
    finished = assign_rows(read_runs(runs), conf, first, known_rows(conf, paths))
    tests, begun = with_training(read_robustness(runs), finished), unfinished(runs)
    of_datasets = [load_dataset_table(path) for path in paths if is_dataset_table(path)]

    def sweep_of(setting: tuple[str, ...]) -> Sweep:
        kept, remark = comparable(finished, setting, first)
        rows = by_row(kept)
        datasets = [with_records(table, [*kept, *finished]) for table in of_datasets]
        order = [row for row in dict.fromkeys([*first, *rows]) if row in rows]
        own = [test for test in tests if test.system in {run.name for run in kept}]
        ordered = {row: rows[row] for row in order}
        return Sweep(kept, ordered, remark, facts_of_scenes(kept[0]), found, datasets, unfinished=begun, robustness=own)

    seed_stds = load_seed_stds(tables / POWER)
    sweeps = [sweep_of(setting) for setting in settings_of(finished, preset)]
    left_out = {run.name for run in finished} - {run.name for sweep in sweeps for run in sweep.runs}
    sweeps[0] = sweeps[0]._replace(robustness=[test for test in tests if test.system not in left_out])
    once = [table for table in found if not table.of_lengths]

    def placed(sweep: Sweep, of_sweep: Sequence[PaperTable]) -> Sweep:
        setting = sweep.runs[0].setting
        of_steps = [table.of_steps(setting[1]) for table in of_sweep]
        lengths, left = by_length(sweeps, setting)
        return sweep._replace(tables=of_steps, lengths=lengths, remark=sweep.remark + left)

    return [
        placed(sweep, once if number else found)._replace(
            longer=sorted(
                (placed(other, once) for other in sweeps if _is_longer(other, sweep)),
                key=lambda other: _number(other.runs[0].setting[1]),
            ),
            seed_stds=seed_stds,
        )
        for number, sweep in enumerate(sweeps)
    ]


def _is_longer(other: Sweep, sweep: Sweep) -> bool:
    (preset, steps, data), (other_preset, other_steps, other_data) = sweep.runs[0].setting, other.runs[0].setting
    longer = (preset, data) == (other_preset, other_data) and _number(other_steps) > _number(steps)
    return longer and not counted_otherwise(other.runs, sweep.runs)


def _number(steps: str) -> int:
    return int(steps) if steps.isdigit() else 0


def by_length(sweeps: Sequence[Sweep], setting: tuple[str, ...]) -> tuple[dict[str, Sequence[FinishedRun]], str]:
    """Return the runs of a setting's preset by `row@steps`; of two datasets, those of the one with more runs.

    Also returns a sentence on those that are left out, since they counted their scores by another protocol.

    Args:
        sweeps: of all settings, that with most runs first.
        setting: preset, steps and data. With other data than the first sweep of the preset nothing is returned, so that
            models trained on different streets are not compared.
    """
    preset, _, data = setting
    alike = [sweep for sweep in sweeps if sweep.runs[0].setting[0] == preset]
    if alike[0].runs[0].setting[2] != data:
        return {}, ""
    own = next(sweep.runs for sweep in alike if sweep.runs[0].setting == setting)
    every = [run for sweep in alike for run in sweep.runs]
    otherwise = counted_otherwise(every, own)
    found: dict[str, Sequence[FinishedRun]] = {}
    for sweep in alike:
        for row, runs in sweep.rows.items():
            if not any(run.name in otherwise for run in runs):
                found.setdefault(f"{row}@{runs[0].setting[1]}", runs)
    return found, otherwise_text(every, otherwise)


def with_training(tests: Sequence[Robustness], runs: Sequence[FinishedRun]) -> list[Robustness]:
    """Return the tests with steps and seed of the runs they belong to, in the order of row, steps and seed."""
    known = {run.name: (run.setting[1], str(run.facts.get("seed", "unknown"))) for run in runs}

    def place(test: Robustness) -> tuple[str, int, str]:
        steps, seed = known.get(test.system, ("", ""))
        return HASH.sub("", test.system), _number(steps), seed

    return [
        test._replace(training="{} steps, seed {}".format(*known[test.system])) if test.system in known else test
        for test in sorted(tests, key=place)
    ]


def unfinished(runs: Path) -> list[str]:
    """Return runs of a folder that have a configuration and no figures yet: still training, or stopped.

    Those with damaged curves are left out with a warning.
    """
    found = []
    for path in sorted(runs.glob("*/config.yaml")):
        if not os.path.lexists(path.parent / METRICS):
            try:
                step = max(read_curve(path.parent, "train/loss"), default=0)
            except (UserError, OSError) as error:
                print(f"left out: {error}", file=sys.stderr, flush=True)
                continue
            found.append(f"{path.parent.name} (step {step})")
    return found
