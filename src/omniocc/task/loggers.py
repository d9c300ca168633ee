"""Where curves go: always a CSV file, and W&B offline unless told otherwise."""

import hashlib
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Literal

from lightning.pytorch.loggers import CSVLogger, Logger, WandbLogger

from omniocc.errors import UserError


class Loggers:
    """Recipe for the loggers of one run.

    Args:
        mode: of W&B; `disabled` leaves only the CSV file.
        project: W&B project.
        group: W&B group, the sweep a run belongs to.
        tags: W&B tags.
    """

    def __init__(
        self, mode: Literal["offline", "online", "disabled"], project: str, group: str | None, tags: Sequence[str]
    ):
        self.mode = mode
        self.project = project
        self.group = group
        self.tags = list(tags)

    def build(self, folder: Path, config: dict) -> list[Logger]:
        """Loggers that write below `folder`; the W&B id follows from it, so a resumed run continues its curve.

        Raises:
            UserError: for `mode=online` without W&B credentials (W&B itself would stop and ask).
        """
        loggers: list[Logger] = [CSVLogger(folder, name="csv")]
        if self.mode != "disabled":
            loggers.append(self._wandb(folder, config))
        return loggers

    def _wandb(self, folder: Path, config: dict) -> WandbLogger:
        os.environ.setdefault("WANDB_SILENT", "true")
        import wandb  # seconds of import that CSV-only runs do not pay

        if self.mode == "online" and not wandb.api.api_key:
            raise UserError("logger.mode=online needs W&B credentials: run `wandb login` or set WANDB_API_KEY")
        return WandbLogger(
            name=folder.name,
            save_dir=folder,
            id=run_id(folder),
            project=self.project,
            offline=self.mode == "offline",
            group=self.group,
            tags=self.tags,
            resume="allow",
            config=config,
        )


def finish(loggers: Sequence[Logger]) -> None:
    """End the W&B run of a trainer that is done; another one in this process would go on in it."""
    for logger in loggers:
        if isinstance(logger, WandbLogger):
            logger.experiment.finish()


def run_id(folder: Path) -> str:
    """A W&B run id that is the same each time this run folder is used, on this machine."""
    return hashlib.sha256(str(folder.resolve()).encode()).hexdigest()[:16]
