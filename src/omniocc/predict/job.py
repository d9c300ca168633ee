"""Predict sequences into folders; frames that are finished already are skipped."""

import statistics
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from torch import Tensor

from omniocc.batch import Truth
from omniocc.classes import FREE, UNKNOWN
from omniocc.draw import save_png
from omniocc.draw.voxel_sheet import RangePanorama, occupancy_sheet
from omniocc.predict.input.schedule import History
from omniocc.predict.input.sequence import FrameSequence, raise_poses
from omniocc.predict.options import Options
from omniocc.predict.output.range_files import OVERVIEW
from omniocc.predict.output.voxel_files import (
    VOXELS,
    raise_grid,
    range_arrays,
    read_labels,
    voxel_arrays,
    write_mesh,
    write_voxels,
)
from omniocc.predict.predictor import STEPS, Images, Input, PredictedFrame, Predictor
from omniocc.predict.stopwatch import Stopwatch
from omniocc.predict.training_data import TrainingData
from omniocc.progress import Progress, clock

if TYPE_CHECKING:
    from omniocc.scores import Scores

ShowFrame = Callable[["Job", FrameSequence, int, Images, PredictedFrame, Truth | None], None]
"""Shows one frame: given the job, its sequence and index, its images, its prediction, and the truth if there is any."""


@dataclass
class Job:
    """Predict sequences, write their files and score them where there is ground truth.

    Attributes:
        predictor: the model, on its device.
        history: how frames get their past.
        trained: the data of the training, whose `classes` and `ignore` are used.
        options: those of the command.
        scores: against the ground truth; None for a user's own images.
        show: is called with every prediction after its files are written; None shows nothing.
        seconds: by step, of every frame that was predicted.
    """

    predictor: Predictor
    history: History
    trained: TrainingData
    options: Options
    scores: "Scores | None"
    show: ShowFrame | None = None
    seconds: list[dict[str, float]] = field(default_factory=list)

    @property
    def output(self) -> Path:
        """Return the folder of all files."""
        return Path(self.options.output)

    def run(self, sequences: Sequence[FrameSequence]) -> None:
        """Predict all wanted frames of the sequences.

        Raises:
            UserError, OSError: naming the image that cannot be used or the file that cannot be written.
        """
        left = [self.left_of(sequence) for sequence in sequences]
        total = sum(map(len, left))
        if skipped := sum(len(sequence.wanted) for sequence in sequences) - total:
            print(f"{skipped} frames are finished in {self.output} and skipped; force=true predicts them again")
        with Progress(f"predicting into {self.output}", total) as progress:
            for sequence, wanted in zip(sequences, left, strict=True):
                for frame in sorted(set(sequence.wanted) - set(wanted)):
                    self._score_finished(sequence, frame)
                for found in self.predictor.frames(wanted, self.history, partial(self.predictor.read, sequence)):
                    progress.message(self._keep(sequence, *found))
                    progress.advance()

    def left_of(self, sequence: FrameSequence) -> list[int]:
        """Return the wanted frames of a sequence that are not finished."""
        return [k for k in sequence.wanted if self.options.force or not (self._folder(sequence, k) / VOXELS).is_file()]

    def summary(self) -> list[str]:
        """Return a line about the time it took; none if nothing was predicted."""
        if not self.seconds:
            return []
        median = {step: statistics.median(seconds[step] for seconds in self.seconds) for step in STEPS}
        total_s = sum(sum(seconds.values()) for seconds in self.seconds)
        steps = ", ".join(f"{step} {value:.2f} s" for step, value in median.items())
        count = len(self.seconds)
        return [f"{count} frame{'s' * (count != 1)} in {clock(total_s)}; median per frame: {steps}"]

    def _keep(
        self, sequence: FrameSequence, frame: int, given: Input, prediction: PredictedFrame, watch: Stopwatch
    ) -> str:
        """Write, show and score a prediction, and return a line about it."""
        truth = sequence.truth(frame, self.predictor.model.geometry, self.trained.ignore)
        if truth is None:  # scores are of every cell, as in a test
            prediction = prediction.without_unseen()
        with watch("write"):
            self._write(sequence, frame, given.original, prediction, truth)
        if self.show is not None:
            self.show(self, sequence, frame, given.original, prediction, truth)
        scored = "" if truth is None else f"{self._score(prediction.labels, truth)}; "
        self.seconds.append(watch.seconds)
        occupied = int(((prediction.labels != FREE) & (prediction.labels != UNKNOWN)).sum())
        written = self._folder(sequence, frame) / (OVERVIEW if self.options.overview else VOXELS)
        return f"{written}: {occupied} voxels; {scored}{watch}"

    def _write(
        self,
        sequence: FrameSequence,
        frame: int,
        images: Images,
        prediction: PredictedFrame,
        truth: Truth | None,
    ) -> None:
        folder = self._folder(sequence, frame)
        predictor, classes = self.predictor, self.trained.classes
        geometry, labels = predictor.model.geometry, prediction.labels
        grid = raise_grid(geometry, sequence.origin_z_m)
        if self.options.mesh:
            write_mesh(folder, labels, grid, classes)
        if self.options.overview:
            missing = f", without {', '.join(predictor.excluded)}" * bool(predictor.excluded)
            caption = f"{f'{sequence.name} {sequence.frame_names[frame]}'.strip()}{missing}".lstrip(", ")
            ranges = None
            if predictor.panorama is not None and prediction.range_m is not None:
                ranges = RangePanorama(predictor.panorama, prediction.range_m)
            voxels = None if truth is None else truth.voxels[0]
            sheet = occupancy_sheet(
                images, sequence.rig, labels, geometry, classes, ranges=ranges, truth=voxels, caption=caption
            )
            save_png(folder / OVERVIEW, sheet)
        poses = sequence.world_from_ego
        pose = None if poses is None else raise_poses(poses[frame], -sequence.origin_z_m)
        arrays = voxel_arrays(prediction, grid, classes, pose)
        if predictor.panorama is not None and prediction.range_m is not None:
            arrays |= range_arrays(prediction.range_m, predictor.panorama, sequence.origin_z_m)
        write_voxels(folder, arrays)

    def _score_finished(self, sequence: FrameSequence, frame: int) -> None:
        geometry = self.predictor.model.geometry
        truth = sequence.truth(frame, geometry, self.trained.ignore)
        if truth is not None:
            self._score(read_labels(self._folder(sequence, frame), geometry), truth)

    def _score(self, labels: Tensor, truth: Truth) -> str:
        """Add a frame to the scores and return its own in a few words."""
        from omniocc.metric import VoxelIoU  # needs torchmetrics, whose import takes a second

        assert self.scores is not None
        self.scores.update(labels[None], truth)
        frame_iou = VoxelIoU(self.trained.classes.num_classes, class_names=self.trained.classes.names)
        frame_iou.update(labels[None], truth.voxels)
        own = frame_iou.compute()
        return f"IoU {own['iou']:.3f}, mIoU {own['miou']:.3f}"

    def _folder(self, sequence: FrameSequence, frame: int) -> Path:
        return self.output / sequence.name / sequence.frame_names[frame]
