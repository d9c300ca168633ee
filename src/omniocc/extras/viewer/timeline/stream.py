"""Show each prediction of `predict.py` in a running viewer as soon as it is made."""

from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

import numpy as np
import rerun as rr
from jaxtyping import Float32
from torch import Tensor

from omniocc.batch import Truth
from omniocc.camera import Equirectangular, Rig
from omniocc.classes import WORLD_CLASSES
from omniocc.extras.viewer.frames import FramePrediction, ShownFrame
from omniocc.extras.viewer.models import frame_figures, scene_scores
from omniocc.extras.viewer.predictions import OWN_INTERVAL_S
from omniocc.extras.viewer.scenes import rig_at_sizes, time_of
from omniocc.extras.viewer.timeline.log import Timeline
from omniocc.extras.viewer.timeline.sinks import to_viewer
from omniocc.predict.input.sequence import FrameSequence, RecordedSequence
from omniocc.predict.job import Job
from omniocc.predict.predictor import PredictedFrame
from rayiou import sparseocc_directions

__all__ = ["RangeStream", "VoxelStream", "to_viewer"]
MODEL = "prediction"
"""Name of the model on the time line."""


class VoxelStream:
    """A `ShowFrame` (`omniocc.predict.job`) that logs every frame of `predict.py occupancy`."""

    def __init__(self, recording: rr.RecordingStream):
        self.recording = recording
        self.timeline: Timeline | None = None
        # Frames come scene by scene: those of one scene share its scores, which `frame_figures` resets.
        self.scores = lru_cache(maxsize=1)(scene_scores)

    def __call__(
        self,
        job: Job,
        sequence: FrameSequence,
        frame: int,
        images: Sequence[np.ndarray],
        prediction: PredictedFrame,
        truth: Truth | None,
    ) -> None:
        """Log one frame."""
        recorded = isinstance(sequence, RecordedSequence)
        if self.timeline is None:
            interval_s = sequence.spec.frame_interval_s if recorded else OWN_INTERVAL_S
            self.timeline = Timeline(self.recording, job.trained.classes, sparseocc_directions(), interval_s)
        grid = job.predictor.model.geometry
        panorama = None if prediction.range_m is None else job.predictor.panorama
        figures = {}
        if truth is not None and recorded:
            figures = frame_figures(self.scores(grid, sequence.scene), prediction.labels, truth)
        poses = sequence.world_from_ego
        shown = ShownFrame(
            scene=sequence.name or Path(job.options.output).name,
            frame=sequence.frame_names[frame],
            time_s=time_of(sequence.scene, frame, self.timeline.interval_s) if recorded else frame * OWN_INTERVAL_S,
            images=tuple(images),
            rig=rig_at_sizes(sequence.rig, images),
            world_from_ego=None if poses is None else poses[frame].numpy(),
            truth={} if truth is None else {grid: truth.voxels[0]},
            lidar=sequence.scene.lidar(frame) if recorded else None,
            predictions={
                MODEL: FramePrediction(
                    prediction.labels, grid, prediction.candidates, prediction.range_m, panorama, figures=figures
                )
            },
        )
        self.timeline.add(shown)


class RangeStream:
    """A `ShowRanges` (`omniocc.predict.depth`) that logs every panorama of `predict.py depth`."""

    def __init__(self, recording: rr.RecordingStream):
        self.timeline = Timeline(recording, WORLD_CLASSES, sparseocc_directions(), OWN_INTERVAL_S)

    def __call__(
        self,
        frame: str,
        images: Sequence[np.ndarray],
        rig: Rig,
        range_m: Float32[Tensor, "h w"],
        panorama: Equirectangular,
    ) -> None:
        """Log one frame."""
        shown = ShownFrame(
            scene="",
            frame=frame,
            time_s=self.timeline.count * OWN_INTERVAL_S,
            images=tuple(images),
            rig=rig_at_sizes(rig, images),
        )
        self.timeline.add(shown, {MODEL: (range_m, panorama)})
