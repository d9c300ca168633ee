"""Score checkpoints under disturbances: what `src/evaluate.py robustness=...` does."""

from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path

import cv2
import numpy as np

from omniocc.config import compose_config
from omniocc.errors import UserError, installing
from omniocc.evaluate import Evaluation, each, folder_of, opened
from omniocc.extras.robustness.evaluation import robustness_of
from omniocc.io import atomic_write
from omniocc.parts import Parts
from omniocc.report.tables.formats import parts_text
from omniocc.report.tables.robustness import report_parts, robustness_csv
from omniocc.runs.robustness import FOLDER, Robustness, save_robustness
from omniocc.runs.table import in_columns
from omniocc.runs.trust import CONF
from omniocc.runs.wandb import Loggers
from omniocc.runs.wandb.loggers import log_robustness


def score_robustness(options: Evaluation) -> None:
    """Score checkpoints under disturbances; write and log the results, print the comparison.

    Raises:
        UserError: when no checkpoint is named, and with the messages of those that cannot be scored.
    """
    if not options.checkpoints:
        raise UserError("name a checkpoint, or a shipped file of weights")
    logging = [word for word in options.overrides if word.startswith("logger.")]
    others = [word for word in options.overrides if word not in logging]
    logger: Loggers = Parts(compose_config(CONF, "train", logging)).loggers()
    records: list[Robustness] = []

    def score(checkpoint: Path) -> None:
        folder = folder_of(checkpoint, f"{FOLDER}{checkpoint.stem}", options.output, True)
        one, wanted = opened(checkpoint, others), options.robustness or ()
        record = robustness_of(one.task, one.data, one.checkpoint, wanted, options.scenes, options.seed, folder)
        save_robustness(folder, record)
        atomic_write(folder / "table.md", parts_text(report_parts([record])))
        atomic_write(folder / "table.csv", robustness_csv([record], {}))
        log_robustness(logger.build(folder, one.task.config, "robustness"), record, draw([record], folder))
        records.append(record)
        print(f"table     {folder / 'table.md'}", flush=True)

    try:
        each(options.checkpoints, score)
    finally:
        if records:
            tables = [f"{in_columns(*part.cells)}\n\n{part.note}" for part in report_parts(records)]
            print("\n\n".join(["", *tables, "all systems: python src/report.py"]))


def draw(records: Sequence[Robustness], folder: Path) -> np.ndarray | None:
    """Write the plot of a test, and return it as an RGB image; None without matplotlib."""
    if find_spec("matplotlib") is None:
        print(f"No plot: matplotlib is missing: {installing('plot')}")
        return None
    from omniocc.report.plots import as_png, drops

    path = folder / "robustness.png"
    atomic_write(path, png := as_png(drops(records)))
    return cv2.cvtColor(np.asarray(cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)), cv2.COLOR_BGR2RGB)
