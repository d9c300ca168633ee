"""Loggers of a run: always a CSV file, and W&B offline unless configured otherwise.

The CSV file has every row on disk at once. W&B writes its file every 15 s, so that after a SIGKILL of the process or of
its whole group the curves lack the rows of at most the last 15 s (measured with W&B 0.31, offline: 40 rows at 0.1 s per
row, 12 rows at 1 s per row). A resumed run does not log rows again that the CSV files have.

Where W&B fails (its process is killed, its disk is full), a run goes on with the CSV file alone: `until_lost`.
"""

import functools
import hashlib
import logging
import math
import os
import re
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Literal, NamedTuple

import numpy as np
from lightning.pytorch.loggers import CSVLogger, Logger, WandbLogger
from lightning.pytorch.utilities.rank_zero import rank_zero_only

from omniocc.errors import UserError, first_line
from omniocc.io import checked_name
from omniocc.runs.curves import curve_files, read_rows
from omniocc.runs.robustness import RAY_IOU, Robustness, drop_of
from omniocc.runs.slots import option_of, slots_of
from omniocc.runs.table import band_names, class_names
from omniocc.runs.wandb.media import MediaItem, wandb_object


class ResultTable(NamedTuple):
    """Column titles, and rows that begin with a name; None where nothing was measured."""

    columns: list[str]
    rows: list[list[str | float | None]]


BY_CLASS = {
    "voxel RayIoU": "test/rayiou/{}",
    "surface RayIoU": "test/lidar/rayiou/{}",
    "IoU": "test/voxel/iou/{}",
    "baseline: voxel RayIoU": "prior/rayiou/{}",
    "upper bound: surface RayIoU": "label/lidar/rayiou/{}",
}
BY_RANGE = {
    "voxel RayIoU": "test/rayiou_{}",
    "surface RayIoU": "test/lidar/rayiou_{}",
    "baseline: voxel RayIoU": "prior/rayiou_{}",
    "depth: MAE, m": "test/depth/mae_{}",
    "depth: AbsRel": "test/depth/absrel_{}",
    "sketch: recall": "test/sketch/recall_{}",
    "sketch: precision": "test/sketch/precision_{}",
    "sketch: fraction": "test/sketch/fraction_{}",
}


PART = re.compile("robustness/(.+)/rayiou")
BY_PART = {
    "RayIoU": "robustness/{}/rayiou",
    "drop": "robustness/{}/drop",
    "standard error": "robustness/{}/error",
}


def result_tables(metrics: Mapping[str, float]) -> dict[str, ResultTable]:
    """Return the tables of a finished test, with the columns that have a figure.

    They are `tables/by_class`, `tables/by_range` and, of a robustness test, `tables/robustness`.
    """
    parts = [match[1] for key in metrics if (match := PART.fullmatch(key))]
    found = {
        "tables/by_class": _table("class", class_names(metrics), BY_CLASS, metrics),
        "tables/by_range": _table("range", band_names(metrics), BY_RANGE, metrics),
        "tables/robustness": _table("disturbance", parts, BY_PART, metrics),
    }
    return {key: table for key, table in found.items() if len(table.columns) > 1}


def _table(title: str, names: Sequence[str], columns: Mapping[str, str], metrics: Mapping[str, float]) -> ResultTable:
    kept = {head: key for head, key in columns.items() if any(key.format(name) in metrics for name in names)}
    rows: list[list[str | float | None]] = [
        [name, *(_figure(metrics.get(key.format(name))) for key in kept.values())] for name in names
    ]
    return ResultTable([title, *kept], rows)


def _figure(value: float | None) -> float | None:
    return None if value is None or math.isnan(value) else float(value)


JobType = Literal["depth", "sketch", "occupancy", "robustness"]
CSV = "csv"
"""Folder of the CSV files, one for every start of the run, in the run's folder."""
CONSTANT = ("test", "prior", "label")
"""Phases whose scalars have one value in a run: W&B gets them in its summary, not as charts with a dot each."""


@dataclass(frozen=True)
class Loggers:
    """Recipe for the loggers of one run.

    Attributes:
        mode: of W&B; `disabled` leaves only the CSV file.
        group: W&B group: the sweep that the run belongs to.
        tags: W&B tags in addition to the row (`name`) of an occupancy run.
    """

    mode: Literal["offline", "online", "disabled"]
    project: str
    group: str | None
    tags: Sequence[str]

    def __post_init__(self) -> None:
        """Check the group; raise UserError if it cannot be a name."""
        if self.group is not None:
            checked_name("group", self.group)

    def build(self, folder: Path, config: dict[str, Any], job_type: JobType) -> list[Logger]:
        """Return the loggers that write below `folder`.

        The W&B id follows from the folder, so that a resumed run continues its curves. The W&B config is the resolved
        one with `row` and `slots.<slot>`, the option in every slot, to group runs by.

        Raises:
            UserError: for `mode=online` without a W&B server that accepts the credentials of this machine.
        """
        earlier = rows_in_csv(folder) if rank_zero_only.rank == 0 else set()
        loggers: list[Logger] = [CSVLogger(folder, name=CSV, flush_logs_every_n_steps=1)]
        # a sweep agent has set the id of one run, which a W&B run of an earlier stage would take
        wanted = "WANDB_SWEEP_ID" not in os.environ or job_type == (config.get("stage") or "occupancy")
        if self.mode != "disabled" and wanted and not WandbCurves.lost:
            os.environ.setdefault("WANDB_SILENT", "true")
            if self.mode == "online":
                check_login("logger.mode=online needs a W&B server")
            loggers.append(WandbCurves(self, folder, config, job_type, earlier))
        return loggers


def row_of(config: Mapping[str, Any], job_type: JobType) -> str:
    """Return the value by which W&B groups runs: the name of the row, or the options of a depth or sketch run."""
    if job_type not in ("depth", "sketch"):
        return config["name"]
    depth = option_of(config["depth"])
    return f"depth {depth}" if job_type == "depth" else f"sketch {option_of(config['model']['sketch'])} on {depth}"


def until_lost(method: Callable[..., Any]) -> Callable[..., Any]:
    """Decorate a method that uses the W&B run: it begins the run, and does nothing after W&B's first failure.

    Failures are errors of W&B and of the system. Others, such as media of a wrong shape, are mistakes of ours.
    """

    @functools.wraps(method)
    def guarded(self: "WandbCurves", *args: Any, **kwargs: Any) -> Any:
        if WandbCurves.lost:
            return None
        try:
            self.begin()
            return method(self, *args, **kwargs)
        except Exception as error:
            if not (isinstance(error, OSError) or type(error).__module__.partition(".")[0] == "wandb"):
                raise
            self.lose(error)
            return None

    return guarded


class WandbCurves(WandbLogger):
    """Lightning's logger for W&B, which does not repeat what an interrupted run has logged.

    Where W&B fails, the run goes on without it: `until_lost`.

    Args:
        recipe: mode, project, group and tags; offline, data stays on the machine until `make wandb-sync`.
        folder: of the run.
        config: the run's resolved configuration; its row is a further tag of an occupancy run.
        job_type: W&B job type, the stage.
        earlier: step and key of the values that the run has logged before it was interrupted.

    Attributes:
        lost: whether W&B has failed in this process; it is used no more then.
    """

    lost: ClassVar[bool] = False

    def __init__(
        self, recipe: Loggers, folder: Path, config: dict[str, Any], job_type: JobType, earlier: set[tuple[int, str]]
    ):
        tags = [config["name"]] if job_type == "occupancy" else []
        super().__init__(
            name=folder.name,
            save_dir=folder,
            id=run_id(folder),
            project=recipe.project,
            offline=recipe.mode == "offline",
            group=recipe.group,
            job_type=job_type,
            tags=list(dict.fromkeys([*tags, *recipe.tags])),
            resume="allow",
            config={**config, "row": row_of(config, job_type), "slots": slots_of(config)},
        )
        # Lightning passes a setting that W&B no longer has, and W&B warns of it in every run
        self._wandb_init.pop("anonymous", None)
        self.earlier = earlier
        self.earlier_phases = {(step, phase_of(key)) for step, key in earlier}
        self.scalars: dict[str, float] = {}

    @rank_zero_only
    def begin(self) -> None:
        """Begin the W&B run, unless it has begun.

        Raises:
            OSError: also where tables could not be written in the end, for which W&B needs a folder below HOME.
        """
        if self._experiment is None:
            from wandb.sdk.artifacts.staging import get_staging_dir

            get_staging_dir()
            logging.raiseExceptions = False  # W&B's log would print a traceback for each line that a full disk refuses
            _ = super().experiment

    @property
    @until_lost
    def experiment(self) -> Any:
        """Return the W&B run; None in other processes than the first and after a failure."""
        return self._experiment

    def lose(self, error: Exception) -> None:
        """Let W&B go after an error, and say so in a line; the run goes on without it."""
        import wandb

        WandbCurves.lost = True
        run, self._experiment = self._experiment, None
        for end in [run.finish, wandb.teardown] if run is not None else [wandb.teardown]:
            # what still works is ended; else Python's end would show W&B's traceback
            with suppress(Exception, SystemExit):
                end()
        print(
            f"W&B is left out from here on ({first_line(error)}); curves and figures are written as before, without "
            "it. See that its disk has space and HOME or WANDB_DATA_DIR can be written, or give logger.mode=disabled",
            flush=True,
        )

    @rank_zero_only
    @until_lost
    def log_metrics(self, metrics: Mapping[str, Any], step: int | None = None) -> None:
        """Log the metrics of a step that were not logged before the run was interrupted; those of a test as summary."""
        scalars = {key: value for key, value in metrics.items() if isinstance(value, int | float)}
        self.scalars |= scalars
        constants = {key: value for key, value in scalars.items() if phase_of(key) in CONSTANT}
        self.log_constants(constants)
        curves = {key: value for key, value in metrics.items() if key not in constants}
        new = {key: value for key, value in curves.items() if (step, key) not in self.earlier}
        if set(new) - {"epoch"}:
            super().log_metrics(new, step)

    @rank_zero_only
    @until_lost
    def log_constants(self, metrics: Mapping[str, float]) -> None:
        """Add values that do not change to the run's summary; nan arrives as none."""
        self.scalars |= metrics
        if metrics:
            self.experiment.summary.update(dict(metrics))

    @rank_zero_only
    @until_lost
    def log_media(self, media: Mapping[str, Sequence[MediaItem]], step: int) -> None:
        """Log images and points under their keys, all of one step in one row.

        They are left out if the scalars of the same phase and step, which follow them, were logged before.
        """
        new = {key: items for key, items in media.items() if (step, phase_of(key)) not in self.earlier_phases}
        if new:
            self.log_metrics({key: [wandb_object(item) for item in items] for key, items in new.items()}, step)

    @rank_zero_only
    @until_lost
    def finish(self) -> None:
        """Log the tables of a test and end the run, so that the next one in this process is a run of its own."""
        import wandb

        if tables := result_tables(self.scalars):
            self.log_metrics(
                {key: wandb.Table(columns=[*table.columns], data=table.rows) for key, table in tables.items()}
            )
        self.experiment.finish()


def check_login(purpose: str) -> None:
    """Ask the W&B server whether it accepts this machine's credentials, for 10 s or `WANDB_HTTP_TIMEOUT`.

    W&B itself would ask for an API key, and would try for minutes to reach a server that does not answer.

    Raises:
        UserError: without credentials, and if the server refuses them or does not answer.
    """
    import wandb  # seconds of import that CSV-only runs do not pay

    try:
        found = wandb.login(prompt=False, verify=True)
    except (wandb.Error, ValueError) as error:  # the latter for settings that are no URL, ...
        reason, remedy = " ".join(str(error).split()), "see network, WANDB_BASE_URL, `wandb login --relogin`"
        raise UserError(
            f"{purpose}: the W&B server refused the login or gave no answer ({remedy}): {reason}"
        ) from error
    if not found:
        raise UserError(f"{purpose}: run `wandb login` or set WANDB_API_KEY first")


def wandb_of(loggers: Sequence[Logger]) -> list[WandbCurves]:
    """Return the loggers that write to W&B; none after it has failed."""
    return [logger for logger in loggers if isinstance(logger, WandbCurves) and not logger.lost]


def log_earlier_stages(loggers: Sequence[Logger], figures: Mapping[str, float], step: int) -> None:
    """Log the figures of the stages before a run, which do not change in it."""
    for logger in loggers:
        if isinstance(logger, WandbCurves):
            logger.log_constants(figures)
        else:
            logger.log_metrics(dict(figures), step)


def finish(loggers: Sequence[Logger]) -> None:
    """End the W&B runs of a finished trainer."""
    for logger in wandb_of(loggers):
        logger.finish()


def run_id(folder: Path) -> str:
    """Return the W&B run id of a run folder: the same at every start on this machine."""
    return hashlib.sha256(str(folder.resolve()).encode()).hexdigest()[:16]


def phase_of(key: str) -> str:
    """Return the part of a metric key before the first slash: train, val, test."""
    return key.partition("/")[0]


def rows_in_csv(folder: Path) -> set[tuple[int, str]]:
    """Return step and key of every value in the complete lines of the CSV files of a run's earlier starts."""
    found = set()
    for path in curve_files(folder):
        for row in read_rows(path):
            step = int(row.pop("step"))
            found |= {(step, key) for key, value in row.items() if value}
    return found


ODD = re.compile(r"[^\w.-]+")


def log_file(folder: Path, file: Path, project: str) -> None:
    """Keep a file for W&B as an artifact of type `view`, in an offline run of its own in a run's folder.

    `make wandb-sync` uploads it with the others; a file that is logged again becomes the artifact's next version.
    """
    os.environ.setdefault("WANDB_SILENT", "true")
    import wandb

    with wandb.init(dir=folder, name=f"{folder.name} view", project=project, job_type="view", mode="offline") as run:
        artifact = wandb.Artifact(ODD.sub("-", f"{folder.name}-{file.name}"), type="view")
        artifact.add_file(str(file))
        run.log_artifact(artifact)
    wandb.teardown()  # `finish` alone may return before the file is whole


def robustness_metrics(record: Robustness) -> dict[str, float]:
    """Return `robustness/<part>/rayiou` of all parts, and `/drop` and its standard `/error` of the disturbed ones."""
    found = {f"robustness/{part.part}/rayiou": part.scores[RAY_IOU] for part in record.parts if RAY_IOU in part.scores}
    for part in record.disturbed:
        drop = drop_of(part, record.undisturbed)
        found |= {f"robustness/{part.part}/drop": drop.value, f"robustness/{part.part}/error": drop.error}
    return found


def log_robustness(loggers: Sequence[Logger], record: Robustness, plot: np.ndarray | None) -> None:
    """Log a finished test, with its plot, (H, W, 3) uint8 RGB, and end the W&B runs.

    W&B does not get again what earlier calls have logged.
    """
    for logger in wandb_of(loggers):
        if plot is not None:
            logger.log_media({"robustness/plot": [MediaItem(plot, record.system)]}, 0)
    for logger in loggers:
        logger.log_metrics(robustness_metrics(record), 0)
        logger.finalize("success")
    finish(loggers)
