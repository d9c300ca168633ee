"""Predictions as files in the format of a benchmark: write those of a model, score those of any other project."""

from collections.abc import Iterator, Sequence
from pathlib import Path

import torch

from omniocc.data import OccupancyData, SceneSource
from omniocc.data.dataset import Needs, WindowDataset, collate
from omniocc.data.origins import Origins
from omniocc.data.source import SPLITS, NumberedSubmissions, PredictionReader, SceneFrames, Split, SubmittedScene
from omniocc.errors import UserError
from omniocc.geometry import sample_nearest
from omniocc.progress import Progress
from omniocc.scores import Scores
from omniocc.train.occupancy import OccupancyTask, predictions


def score_files(
    source: SceneSource, folder: Path, split: Split = "test", origins: Origins = "own"
) -> tuple[dict[str, float], dict[str, str]]:
    """Return the scores of predictions in the benchmark's submission format, with keys as those of a test.

    Also returns how they were counted; see `Scores.protocol`.

    Args:
        source: the dataset, prepared.
        folder: of the files, one for each frame of the split.
        split: the scenes that are scored.
        origins: from where the rays of RayIoU start.

    Raises:
        UserError: if the dataset takes no submissions, its labels are secret, or files are missing.
        DataError: naming a damaged file.
    """
    benchmark = source.spec.benchmark
    scenes = source.scenes(split)
    files = [(scene, frame, folder / scene.prediction_file(frame)) for scene, frame in submitted(scenes)]
    if benchmark is None or not files:
        raise UserError(f"there are no frames of the split '{split}' on which predictions could be scored")
    labels = source.labels(benchmark.grid, "none")
    for scene in scenes:
        if labels.benchmark(scene, 0) is None:
            raise UserError(f"scene '{scene.name}' has no labels here, so that its predictions cannot be scored")
    missing = [path for _, _, path in files if not path.exists()]
    if missing:
        raise UserError(f"{missing[0]}: {len(missing)} of {len(files)} predictions are missing, this is the first")
    own_rays = source.spec.lidar_directions is None
    needs = Needs(images=False, voxels=False, pixel_labels=False)
    data = WindowDataset(scenes, labels, 1, needs, own_rays=own_rays, origins=origins, scored_grid=benchmark.grid)
    scores = Scores(benchmark.grid, source.spec)
    read: PredictionReader = lambda scene, path: scene.read_prediction(path)  # noqa: E731
    if isinstance(source, NumberedSubmissions):
        read, line = source.prediction_reader(files)
        print(line, flush=True)
    with Progress("scores", len(files)) as progress:
        for index, (scene, _, path) in enumerate(files):
            classes = torch.from_numpy(read(scene, path)).unsqueeze(0)
            scores.update(classes, collate([data[index]]))
            progress.advance()
    return {f"test/{key}": float(value) for key, value in scores.compute().items()}, scores.protocol()


def submitted(scenes: Sequence[SceneFrames]) -> Iterator[tuple[SubmittedScene, int]]:
    """Return all frames of scenes whose benchmark takes predictions; raise UserError for others."""
    for scene in scenes:
        if not isinstance(scene, SubmittedScene):
            raise UserError(f"scene '{scene.name}': this dataset has no format of submissions")
        for frame in range(len(scene)):
            yield scene, frame


def frames_of(source: SceneSource, split: Split) -> list[tuple[SubmittedScene, int]]:
    """Prepare a dataset and return all frames of a split.

    Raises:
        UserError: if the split is none or empty, or the dataset takes no submissions.
    """
    if split not in SPLITS:
        raise UserError(f"split={split}: choose {', '.join(SPLITS)}")
    source.prepare()
    frames = list(submitted(source.scenes(split)))
    if not frames:
        raise UserError(f"there are no frames of the split '{split}'")
    return frames


def write_files(
    task: OccupancyTask,
    data: OccupancyData,
    frames: Sequence[tuple[SubmittedScene, int]],
    folder: Path,
    split: Split,
    device: torch.device,
) -> int:
    """Predict all frames of a split, write them in the benchmark's submission format, and return their number.

    `frames` are those of `frames_of`. Files that exist are kept, so that the same command goes on after a stop.

    Raises:
        DataError: when the disk refuses.
    """
    needs = Needs(voxels=False, pixel_labels=False, scores=False)
    data.set_needs(needs, needs)
    data.setup()
    benchmark = data.spec.benchmark
    assert benchmark is not None
    left = [k for k, (scene, frame) in enumerate(frames) if not (folder / scene.prediction_file(frame)).exists()]
    samples = data.dataset(split)
    predicted = predictions(task, (collate([samples[k]]) for k in left), device)
    with Progress("predictions", len(left)) as progress:
        for (scene, frame), (_, labels) in zip((frames[k] for k in left), predicted, strict=True):
            classes = sample_nearest(labels, task.model.geometry, benchmark.grid)
            scene.write_prediction(folder / scene.prediction_file(frame), classes[0].cpu().numpy())
            progress.advance()
    return len(frames)
