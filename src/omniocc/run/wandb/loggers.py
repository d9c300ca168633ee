"""Where curves go: always a CSV file, and W&B offline unless told otherwise."""

import hashlib
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

from lightning.pytorch.loggers import CSVLogger, Logger, WandbLogger
from lightning.pytorch.utilities.rank_zero import rank_zero_only

from omniocc.errors import UserError
from omniocc.run.slots import slots_of
from omniocc.run.wandb.journal import Journal
from omniocc.run.wandb.media import Named, wandb_object
from omniocc.run.wandb.result_tables import result_tables
from omniocc.run.wandb.wandb_file import logged

JobType = Literal["depth", "sketch", "occupancy"]


class Loggers:
    """Recipe for the loggers of one run.

    Args:
        mode: of W&B; `disabled` leaves only the CSV file.
        project: W&B project.
        group: W&B group, the sweep a run belongs to.
        tags: W&B tags, beside the row (`name`) of an occupancy run.
    """

    def __init__(
        self, mode: Literal["offline", "online", "disabled"], project: str, group: str | None, tags: Sequence[str]
    ):
        self.mode = mode
        self.project = project
        self.group = group
        self.tags = list(tags)

    def build(self, folder: Path, config: dict[str, Any], job_type: JobType) -> list[Logger]:
        """Loggers that write below `folder`.

        The W&B id follows from the folder, so that a resumed run continues its curve. Its config is the resolved one
        with `row` and `slots.<slot>`, the option in every slot, to group runs by.

        Raises:
            UserError: for `mode=online` without W&B credentials (W&B itself would stop and ask).
        """
        loggers: list[Logger] = [CSVLogger(folder, name="csv")]
        # an agent has named one run, and a W&B run of a stage before it would take that name
        wanted = "WANDB_SWEEP_ID" not in os.environ or job_type == (config.get("stage") or "occupancy")
        if self.mode != "disabled" and wanted:
            loggers.append(self._wandb(folder, config, job_type))
        return loggers

    def _wandb(self, folder: Path, config: dict[str, Any], job_type: JobType) -> "WandbCurves":
        os.environ.setdefault("WANDB_SILENT", "true")
        if self.mode == "online" and not logged_in():
            raise UserError("logger.mode=online needs W&B credentials: run `wandb login` or set WANDB_API_KEY")
        return WandbCurves(folder, self.mode == "offline", self.project, self.group, self.tags, job_type, config)


class WandbCurves(WandbLogger):
    """Lightning's logger for W&B; what the run has logged before it was interrupted is not logged again.

    Args:
        folder: of the run.
        offline: whether nothing leaves the machine before `make wandb-sync`.
        project: W&B project.
        group: W&B group.
        tags: W&B tags; the row of an occupancy run is added.
        job_type: W&B job type, the stage.
        config: the run's resolved configuration.
    """

    def __init__(
        self,
        folder: Path,
        offline: bool,
        project: str,
        group: str | None,
        tags: Sequence[str],
        job_type: JobType,
        config: dict[str, Any],
    ):
        row = {"row": config["name"]} if job_type == "occupancy" else {}
        super().__init__(
            name=folder.name,
            save_dir=folder,
            id=run_id(folder),
            project=project,
            offline=offline,
            group=group,
            job_type=job_type,
            tags=list(dict.fromkeys([*row.values(), *tags])),
            resume="allow",
            config={**config, **row, "slots": slots_of(config)},
        )
        # Lightning passes on a setting that W&B has given up, and W&B says so in every run
        self._wandb_init.pop("anonymous", None)
        self.journal = Journal(folder / "wandb" / "rows.jsonl")
        self.before: set[tuple[int, str]] = set()
        self.lost: list[tuple[int, dict[str, float]]] = []
        self.figures: dict[str, float] = {}
        if rank_zero_only.rank == 0:
            self.before, rows = logged(folder), self.journal.read()
            self.lost = [(step, self._fresh(row, step)) for step, row in rows]
            self.before |= {(step, key) for step, row in rows for key in row}

    @rank_zero_only
    def log_metrics(self, metrics: Mapping[str, Any], step: int | None = None) -> None:
        """Log what this step has not been said to have, and before that what W&B lost when the run was killed."""
        while self.lost:
            lost_step, row = self.lost.pop(0)
            self._log(row, lost_step)
        scalars = {key: value for key, value in metrics.items() if isinstance(value, int | float)}
        self.figures |= scalars
        fresh = self._fresh(metrics, step)
        if step is not None and (noted := self._fresh(scalars, step)):
            self.journal.add(step, noted)
        self._log(fresh, step)

    def _fresh(self, metrics: Mapping[str, Any], step: int | None) -> dict[str, Any]:
        return {key: value for key, value in metrics.items() if (step, key) not in self.before}

    def _log(self, metrics: dict[str, Any], step: int | None) -> None:
        if set(metrics) - {"epoch"}:
            super().log_metrics(metrics, step)

    @rank_zero_only
    def log_media(self, media: Mapping[str, Sequence[Named]], step: int) -> None:
        """Log pictures and points under their keys, all of one step in one row."""
        if fresh := self._fresh(media, step):
            self.log_metrics({key: [wandb_object(item) for item in items] for key, items in fresh.items()}, step)

    @rank_zero_only
    def finish(self) -> None:
        """Log the tables of a test and end the run; another one in this process would go on in it."""
        import wandb

        tables = result_tables(self.figures)
        if tables:
            self.log_metrics(
                {key: wandb.Table(columns=[*table.columns], data=table.rows) for key, table in tables.items()}
            )
        self.experiment.finish()


def logged_in() -> bool:
    """Whether there are W&B credentials; nothing is asked, and no server either."""
    import wandb  # seconds of import that CSV-only runs do not pay

    return wandb.login(prompt=False, verify=False)


def wandb_of(loggers: Sequence[Logger]) -> list[WandbCurves]:
    """Those that write to W&B."""
    return [logger for logger in loggers if isinstance(logger, WandbCurves)]


def finish(loggers: Sequence[Logger]) -> None:
    """End the W&B runs of a trainer that is done."""
    for logger in wandb_of(loggers):
        logger.finish()


def run_id(folder: Path) -> str:
    """A W&B run id that is the same each time this run folder is used, on this machine."""
    return hashlib.sha256(str(folder.resolve()).encode()).hexdigest()[:16]
