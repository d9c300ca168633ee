"""A robustness test in the logs of W&B and CSV: scores and drops of every part, a table, and the plot."""

from collections.abc import Sequence

import numpy as np
from lightning.pytorch.loggers import Logger

from omniocc.runs.robustness import RAY_IOU, Robustness, drop_of
from omniocc.runs.wandb.loggers import finish, wandb_of
from omniocc.runs.wandb.media import Named


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
            logger.log_media({"robustness/plot": [Named(plot, record.system)]}, 0)
    for logger in loggers:
        logger.log_metrics(robustness_metrics(record), 0)
        logger.finalize("success")
    finish(loggers)
