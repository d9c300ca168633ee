"""Hydra plug-in: `--multirun +sweep=refine seed=0,1` trains every row of a table (`sweeps/refine.yaml`)."""

import functools
from pathlib import Path

from hydra._internal.core_plugins.basic_sweeper import BasicSweeper
from hydra.core.override_parser.types import Override
from omegaconf import OmegaConf

from omniocc.errors import UserError
from omniocc.run.rows import TABLES, jobs_of, known_rows, table_files


class TableSweeper(BasicSweeper):
    """Hydra's sweeper of all combinations; with `+sweep=<table>,...` each of them for every row of these tables.

    `+sweep=<table>/<row>` names a single row. Where the command line has no `seed`, a single table's `seeds` are used.
    """

    def split_arguments(self, overrides: list[Override], max_batch_size: int | None) -> list[list[list[str]]]:
        """Return batches of jobs, a list of overrides each."""
        chosen = [one for one in overrides if one.get_key_element() == f"+{TABLES}"]
        others = [one for one in overrides if one not in chosen]
        (jobs,) = BasicSweeper.split_arguments(others, None)
        for one in chosen:
            names = list(one.sweep_string_iterator()) if one.is_sweep_override() else [one.get_value_element_as_str()]
            tables = [self._table(name) for name in names]
            seeds = tables[0].get("seeds") if len(tables) == 1 else None
            if seeds and not any(other.get_key_element() == "seed" for other in others):
                jobs = [[*job, f"seed={seed}"] for job in jobs for seed in seeds]
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
        """Return the content of a table, of `<table>/<row>` with this row alone."""
        assert self.hydra_context is not None
        stem, _, chosen = name.partition("/")
        for source in self.hydra_context.config_loader.get_sources():
            if source.is_config(f"{TABLES}/{stem}.yaml"):
                table: dict = OmegaConf.to_container(source.load_config(f"{TABLES}/{stem}.yaml").config)  # type: ignore
                rows = {key: row for key, row in table["rows"].items() if chosen in ("", key, key.partition("@")[0])}
                if not rows:
                    raise UserError(f"+{TABLES}={name}: the table has no such row; it has {', '.join(table['rows'])}")
                return {**table, "rows": rows}
        raise UserError(f"+{TABLES}={name}: there is no such table")
