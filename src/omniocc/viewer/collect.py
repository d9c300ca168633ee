"""Collect what a viewer shows: frames of scenes, with the predictions of models that are computed now."""

from collections.abc import Iterator, Sequence

import torch
from torch import Tensor

from omniocc.batch import Batch
from omniocc.data.source import SceneFrames
from omniocc.geometry import Cylinder, Grid
from omniocc.metric import sparseocc_directions
from omniocc.predict.predictor import Prediction
from omniocc.task.scores import Scores
from omniocc.viewer.frames import FramePrediction, Shown, ShownFrame
from omniocc.viewer.models import PixelLabels, TrainedModel, check_classes, frame_figures, load_models
from omniocc.viewer.options import ViewOptions, unique_names
from omniocc.viewer.scenes import ChosenScenes, recorded_scenes, test_scenes, time_of


def open_shown(options: ViewOptions) -> Shown:
    """Return what the options choose; models are loaded, frames are computed when they are iterated.

    Frames are those of the first run's test scenes, or of `recorded`; all runs predict the same ones.

    Raises:
        UserError, OSError: naming the option that cannot be used.
    """
    models = load_models(options.run, unique_names(options.run), options.device)
    scenes = _scenes(options, models)
    check_classes(models, scenes)
    grids = tuple(dict.fromkeys(model.grid for model in models)) or (Cylinder(),)
    return Shown(
        classes=scenes.spec.classes,
        models=tuple(model.name for model in models),
        grids=grids,
        road_z_m=scenes.spec.road_z_m,
        frame_interval_s=scenes.spec.frame_interval_s,
        directions=sparseocc_directions(),
        source=scenes.source,
        fingerprint=scenes.fingerprint,
        frames=tuple((scene.name, name_of(frame)) for scene, wanted in scenes.scenes for frame in wanted),
        read=lambda: _frames(scenes, models, grids),
    )


def name_of(frame: int) -> str:
    """Return the name of a recorded frame: its number, as in `predict.py`."""
    return f"{frame:06d}"


def _scenes(options: ViewOptions, models: Sequence[TrainedModel]) -> ChosenScenes:
    panorama = next((model.predictor.panorama for model in models), None)
    chosen = options.scene, options.frames, options.limit
    if options.recorded is None:
        return test_scenes(models[0].data, *chosen, panorama)
    unknown = models[0].trained.unknown if models else "free"
    return recorded_scenes(options.recorded, *chosen, unknown, panorama)


def _frames(scenes: ChosenScenes, models: Sequence[TrainedModel], grids: Sequence[Grid]) -> Iterator[ShownFrame]:
    scores = [Scores(model.grid, scenes.spec) for model in models]
    for scene, wanted in scenes.scenes:
        predicted = [model.predict(scene, wanted) for model in models]
        for frame, *answers in zip(wanted, *predicted, strict=True):
            truth = {grid: scenes.truth(scene, frame, grid) for grid in grids}
            named = {
                model.name: _prediction(model, answer, truth[model.grid], own)
                for model, answer, own in zip(models, answers, scores, strict=True)
            }
            voxels = {grid: batch.voxels[0] for grid, batch in truth.items() if batch and batch.voxels is not None}
            yield _frame(scenes, scene, frame, voxels, named)


def _prediction(
    model: TrainedModel, answer: tuple[Prediction, PixelLabels], truth: Batch | None, scores: Scores
) -> FramePrediction:
    prediction, pixels = answer
    return FramePrediction(
        labels=prediction.labels,
        grid=model.grid,
        candidates=prediction.candidates,
        range_m=prediction.range_m,
        panorama=None if prediction.range_m is None else model.predictor.panorama,
        pixel_labels=pixels,
        figures={} if truth is None else frame_figures(scores, prediction.labels, truth),
    )


def _frame(
    scenes: ChosenScenes,
    scene: SceneFrames,
    frame: int,
    voxels: dict[Grid, Tensor],
    predictions: dict[str, FramePrediction],
) -> ShownFrame:
    range_m = scene.erp_range_m(frame)
    return ShownFrame(
        scene=scene.name,
        frame=name_of(frame),
        time_s=time_of(scene, frame, scenes.spec.frame_interval_s),
        images=tuple(scene.images(frame)),
        rig=scene.rigs[frame],
        world_from_ego=scene.world_from_ego[frame],
        truth=voxels,
        range_m=None if range_m is None else torch.from_numpy(range_m),
        panorama=None if range_m is None else scenes.true_panorama(scene, range_m.shape),
        lidar=scene.lidar(frame),
        predictions=predictions,
    )
