"""Collect what a viewer shows: frames of scenes, with the predictions of models that are computed now."""

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from omniocc.batch import Batch
from omniocc.extras.viewer.frames import FramePrediction, Shown, ShownFrame
from omniocc.extras.viewer.models import PixelLabels, TrainedModel, check_classes, frame_figures, scores_of
from omniocc.extras.viewer.options import ViewOptions, unique_names
from omniocc.extras.viewer.predictions import open_predictions
from omniocc.extras.viewer.scenes import ChosenScenes, recorded_frame, recorded_scenes, test_scenes
from omniocc.geometry import Cylinder, Grid
from omniocc.predict.input.sequence import frame_name
from omniocc.predict.options import choose_device
from omniocc.predict.predictor import PredictedFrame, Predictor
from omniocc.predict.trained import load
from omniocc.progress import Progress
from rayiou import sparseocc_directions

if TYPE_CHECKING:
    from omniocc.scores import Scores

PAPER_GRID = Cylinder()


def open_shown(options: ViewOptions, grids: Sequence[Grid] = (PAPER_GRID,)) -> Shown:
    """Return what the options choose; models are loaded, frames are computed when they are iterated.

    Frames are those of the first run's test scenes, or of `recorded`; all runs predict the same ones. `grids` are those
    of the true voxels where there is no model.

    Raises:
        UserError, OSError: naming the option that cannot be used.
    """
    if options.predictions is not None:
        return open_predictions(options)
    trained, device = map(load, options.run), choose_device(options.device)
    models = [
        TrainedModel(name, one, Predictor(one.occupancy, None, (), device, one.occupied_above))
        for name, one in zip(unique_names(options.run), trained, strict=True)
    ]
    scenes = _scenes(options, models)
    check_classes(models, scenes)
    return show_scenes(scenes, models, tuple(dict.fromkeys(model.grid for model in models)) or tuple(grids))


def show_scenes(scenes: ChosenScenes, models: Sequence[TrainedModel], grids: tuple[Grid, ...]) -> Shown:
    """Return scenes as some models predict them, with the truth on every grid."""
    return Shown(
        classes=scenes.spec.classes,
        models=tuple(model.name for model in models),
        grids=grids,
        road_z_m=scenes.spec.road_z_m,
        frame_interval_s=scenes.spec.frame_interval_s,
        directions=sparseocc_directions(),
        source=scenes.source,
        fingerprint=scenes.fingerprint,
        frames=tuple((scene.name, frame_name(frame)) for scene, wanted in scenes.scenes for frame in wanted),
        read=lambda: _frames(scenes, models, grids),
    )


def with_progress(shown: Shown) -> Iterator[ShownFrame]:
    """Return the frames one by one, and show how many are done and how long the others take."""
    with Progress("frames", len(shown)) as progress:
        for frame in shown:
            yield frame
            progress.advance(text=f"{frame.scene} {frame.frame}")


def _scenes(options: ViewOptions, models: Sequence[TrainedModel]) -> ChosenScenes:
    panorama = next((model.predictor.panorama for model in models), None)
    chosen = options.scene, options.frames, options.limit
    if options.recorded is None:
        return test_scenes(models[0].trained.data, *chosen, panorama)
    ignore = models[0].trained.facts.ignore if models else "none"
    return recorded_scenes(options.recorded, *chosen, ignore, panorama)


def _frames(scenes: ChosenScenes, models: Sequence[TrainedModel], grids: Sequence[Grid]) -> Iterator[ShownFrame]:
    scores = [scores_of(model.grid, scenes.spec) for model in models]
    for scene, wanted in scenes.scenes:
        predicted = [model.predict(scene, wanted) for model in models]
        for frame, *answers in zip(wanted, *predicted, strict=True):
            truth = {grid: scenes.truth(scene, frame, grid) for grid in grids}
            named = {
                model.name: _prediction(model, answer, truth[model.grid], own)
                for model, answer, own in zip(models, answers, scores, strict=True)
            }
            voxels = {grid: batch.voxels[0] for grid, batch in truth.items() if batch and batch.voxels is not None}
            yield recorded_frame(scenes, scene, frame, voxels, named)


def _prediction(
    model: TrainedModel, answer: tuple[PredictedFrame, PixelLabels], truth: Batch | None, scores: "Scores"
) -> FramePrediction:
    found, pixels = answer
    panorama = None if found.range_m is None else model.predictor.panorama
    figures = {} if truth is None else frame_figures(scores, found.labels, truth)
    return FramePrediction(found.labels, model.grid, found.candidates, found.range_m, panorama, pixels, figures=figures)
