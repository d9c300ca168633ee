"""Hydra plug-in: `--multirun +sweep=refine seed=0,1` trains every row of a table (`sweeps/refine.yaml`)."""

import functools
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from hydra._internal.core_plugins.basic_sweeper import BasicSweeper
from hydra.core.override_parser.types import Override
from omegaconf import OmegaConf

from omniocc.errors import UserError
from omniocc.runs.rows import TABLES, jobs_of, known_rows, table_files

ROW = "+row"


def values_of(overrides: Sequence[Override], key: str) -> list[str]:
    """Return all values of a key of the command line, of which a list has several."""
    found = [one for one in overrides if one.get_key_element() == key]
    lists = [
        one.sweep_string_iterator() if one.is_sweep_override() else [one.get_value_element_as_str()] for one in found
    ]
    return [value for values in lists for value in values]


class TableSweeper(BasicSweeper):
    """Hydra's sweeper of all combinations; with `+sweep=<table>,...` each of them for every row of these tables.

    `+row=<row>,...` chooses among the rows. Where the command line has no `seed`, a single table's `seeds` are used.
    """

    def split_arguments(self, overrides: list[Override], max_batch_size: int | None) -> list[list[list[str]]]:
        """Return batches of jobs, a list of overrides each."""
        if max_batch_size is not None and max_batch_size < 1:
            raise UserError(f"hydra.sweeper.max_batch_size={max_batch_size}: give 1 or more, or null for one batch")
        names, chosen = (values_of(overrides, key) for key in (f"+{TABLES}", ROW))
        others = [one for one in overrides if not names or one.get_key_element() not in (f"+{TABLES}", ROW)]
        (jobs,) = BasicSweeper.split_arguments(others, None)
        if names:
            tables = [self._table(name) for name in names]
            known = [row.partition("@")[0] for table in tables for row in table["rows"]]
            if gone := [row for row in chosen if row not in known]:
                raise UserError(
                    f"{ROW}={gone[0]}: there is no such row in {', '.join(names)}; choose {', '.join(known)}"
                )
            seeds = tables[0].get("seeds") if len(tables) == 1 else None
            if seeds and not any(other.get_key_element() == "seed" for other in others):
                jobs = [[*job, f"seed={seed}"] for job in jobs for seed in seeds]
            for table in tables if chosen else ():
                table["rows"] = {key: row for key, row in table["rows"].items() if key.partition("@")[0] in chosen}
            rows = [row for table in tables for row in jobs_of(table, self._known)]
            once = [row for number, row in enumerate(rows) if row not in rows[:number]]
            jobs = [[*row, *job] for row in once for job in jobs]
        return [list(batch) for batch in self.split_overrides_to_chunks(jobs, max_batch_size)]

    @functools.cached_property
    def _known(self) -> dict[str, list[str]]:
        assert self.config is not None
        (conf,) = (Path(s.path) for s in self.config.hydra.runtime.config_sources if s.provider == "main")
        return known_rows(conf, table_files(conf / TABLES))

    def _table(self, name: str) -> dict:
        assert self.hydra_context is not None
        for source in self.hydra_context.config_loader.get_sources():
            if source.is_config(f"{TABLES}/{name}.yaml"):
                table: Any = OmegaConf.to_container(source.load_config(f"{TABLES}/{name}.yaml").config)
                if "rows" not in table or "kind" in table:
                    raise UserError(f"+{TABLES}={name}: this is no table of methods that can be trained")
                return table
        raise UserError(f"+{TABLES}={name}: there is no such table")
