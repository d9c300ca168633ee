"""Predictions of a dataset's split as files in its benchmark's submission format."""

from collections.abc import Sequence
from pathlib import Path

from omniocc.data.source import Split
from omniocc.predict.options import choose_device
from omniocc.run.weights import find_checkpoint
from omniocc.task.build import load_task
from omniocc.task.submission import write_files


def predict_submission(checkpoint: str, output: Path, split: Split, changes: Sequence[str], device: str | None) -> None:
    """Write one file for every frame of the split of the data that a checkpoint was trained on.

    Args:
        checkpoint: of the occupancy stage.
        output: folder of the submission.
        split: train, val or test.
        changes: overrides of the data of training, such as data.source.root=/datasets/kitti.
        device: cpu or cuda; None: cuda if there is one.

    Raises:
        UserError: naming what does not exist or does not fit.
        DataError: naming a damaged file, or when the disk refuses.
    """
    task, data = load_task(find_checkpoint(Path(checkpoint)), list(changes))
    count = write_files(task, data, output, split, choose_device(device))
    print(f"{count} frames in {output}; their scores: python src/evaluate.py predictions={output} data=...")
