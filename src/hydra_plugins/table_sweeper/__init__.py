"""Hydra plug-in: `--multirun +sweep=refine seed=0,1` trains every row of a table (`sweeps/refine.yaml`)."""

from pathlib import Path

from hydra._internal.core_plugins.basic_sweeper import BasicSweeper
from hydra.core.override_parser.types import Override
from omegaconf import OmegaConf

from omniocc.errors import UserError
from omniocc.run.rows import options_of, overrides_of

GROUP = "sweep"


class TableSweeper(BasicSweeper):
    """Hydra's sweeper of all combinations; with `+sweep=<table>,...` each of them for every row of these tables.

    Where the command line has no `seed`, a single table's `seeds` are used.
    """

    def split_arguments(self, overrides: list[Override], max_batch_size: int | None) -> list[list[list[str]]]:
        """Return batches of jobs, a list of overrides each."""
        chosen = [one for one in overrides if one.get_key_element() == f"+{GROUP}"]
        others = [one for one in overrides if one not in chosen]
        (jobs,) = BasicSweeper.split_arguments(others, None)
        for one in chosen:
            names = list(one.sweep_string_iterator()) if one.is_sweep_override() else [one.get_value_element_as_str()]
            tables = [self._table(name) for name in names]
            seeds = tables[0].get("seeds") if len(tables) == 1 else None
            if seeds and not any(other.get_key_element() == "seed" for other in others):
                jobs = [[*job, f"seed={seed}"] for job in jobs for seed in seeds]
            options = self._options
            rows = {name: row for table in tables for name, row in overrides_of(table, options).items()}
            jobs = [[*row, *job] for row in rows.values() for job in jobs]
        return [list(batch) for batch in self.split_overrides_to_chunks(jobs, max_batch_size)]

    @property
    def _options(self) -> dict[str, str]:
        assert self.config is not None
        (conf,) = (s.path for s in self.config.hydra.runtime.config_sources if s.provider == "main")
        return options_of(Path(conf))

    def _table(self, name: str) -> dict:
        assert self.hydra_context is not None
        for source in self.hydra_context.config_loader.get_sources():
            if source.is_config(f"{GROUP}/{name}.yaml"):
                return OmegaConf.to_container(source.load_config(f"{GROUP}/{name}.yaml").config)  # type: ignore
        raise UserError(f"+{GROUP}={name}: there is no such table")
