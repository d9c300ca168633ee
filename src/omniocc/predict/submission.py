"""Predictions of a dataset's split as files in its benchmark's submission format."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from omniocc.data.source import Split
from omniocc.data.store.shard import sha256
from omniocc.predict.options import choose_device
from omniocc.predict.output.manifest import write_manifest
from omniocc.predict.trained import load
from omniocc.train.submission import frames_of, write_files


def changed_places(root: str | None, sequences: Any, split: Split) -> list[str]:
    """Return the overrides of a checkpoint's data for another folder, and for one or several sequences of a split."""
    changes = [] if root is None else [f"data.source.root={root}"]
    if sequences is not None:
        given = [sequences] if isinstance(sequences, int | str) else list(sequences)
        changes.append(f"data.source.sequences.{split}={given}")
    return changes


def predict_submission(
    checkpoint: str, output: Path, split: Split, changes: Sequence[str], device: str | None, force: bool
) -> None:
    """Write one file for every frame of the split of the data that a checkpoint was trained on.

    Args:
        checkpoint: of the occupancy stage.
        output: folder of the submission.
        split: train, val or test.
        changes: overrides of the data of training, such as data.source.root=/datasets/kitti.
        device: cpu or cuda; None: cuda if there is one.
        force: replace predictions of another checkpoint.

    Raises:
        UserError: naming what does not exist or does not fit.
        DataError: naming a damaged file, or when the disk refuses.
    """
    trained = load(checkpoint, changes)
    path, task, data = trained.path, trained.task, trained.data
    frames = frames_of(data.source, split)
    scene, frame = frames[0]
    kind = Path(scene.prediction_file(frame)).suffix
    facts = {"sha256": sha256(path), "data": data.source.fingerprint, "split": split, "changes": list(changes)}
    write_manifest(output, {"checkpoint": str(path.resolve()), **facts}, force, f"*{kind}")
    kept = sum((output / scene.prediction_file(frame)).exists() for scene, frame in frames)
    count = write_files(task, data, frames, output, split, choose_device(device))
    print(f"{count} frames in {output}{f', {kept} of them from before' if kept else ''}")
    print(f"their scores: python src/evaluate.py predictions={output} data=...")
