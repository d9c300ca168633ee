"""Drive after drive through a predictor, into folders; moments that are finished already are left alone."""

import statistics
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from torch import Tensor

from omniocc.classes import WORLD_CLASSES
from omniocc.data.source import Unknown
from omniocc.metric import VoxelIoU
from omniocc.predict.input.schedule import History, Visit, schedule
from omniocc.predict.input.sequence import Drive, Truth, moved_origin
from omniocc.predict.output.voxel_files import (
    PICTURE,
    VOXELS,
    raised_grid,
    read_labels,
    voxel_arrays,
    write_mesh,
    write_voxels,
)
from omniocc.predict.predictor import STEPS, Answer, Predictor, Watch
from omniocc.progress import Progress, clock
from omniocc.task.scores import Scores
from omniocc.view import save_png
from omniocc.view.voxel_sheet import RangePanorama, occupancy_sheet


@dataclass
class Job:
    """Predicts and writes.

    Attributes:
        predictor: the model at work.
        history: how moments get their past.
        unknown: what true cells without points are, as in training.
        output: folder of everything.
        force: whether finished moments are predicted again.
        mesh: whether `voxels.ply` is written.
        picture: whether `picture.png` is drawn.
        scores: against the recorded truth; None for images of a user's own.
        seconds: by step, of every moment that was predicted.
    """

    predictor: Predictor
    history: History
    unknown: Unknown
    output: Path
    force: bool
    mesh: bool
    picture: bool
    scores: Scores | None
    seconds: list[dict[str, float]] = field(default_factory=list)

    @property
    def frames(self) -> int:
        """Of a window, the newest included."""
        return self.predictor.model.temporal.frames

    def run(self, drives: Sequence[Drive]) -> None:
        """All wanted moments of drives.

        Raises:
            UserError, OSError: naming the picture that cannot be used or the file that cannot be written.
        """
        left = [self.left_of(drive) for drive in drives]
        total, skipped = sum(map(len, left)), sum(len(drive.wanted) for drive in drives) - sum(map(len, left))
        if skipped:
            print(f"finished in {self.output} and left alone: {skipped} of the moments; force=true predicts them again")
        with Progress(f"predicting {self.output}", total) as progress:
            for drive, wanted in zip(drives, left, strict=True):
                for moment in sorted(set(drive.wanted) - set(wanted)):
                    self._score_finished(drive, moment)
                for visit in schedule(wanted, self.frames, self.history):
                    line = self._visit(drive, visit)
                    if line:
                        progress.message(line)
                        progress.advance()

    def left_of(self, drive: Drive) -> list[int]:
        """Wanted moments of a drive that are not finished."""
        return [k for k in drive.wanted if self.force or not (self._folder(drive, k) / VOXELS).is_file()]

    def summary(self) -> list[str]:
        """Lines about time."""
        if not self.seconds:
            return []
        median = {step: statistics.median(seconds[step] for seconds in self.seconds) for step in STEPS}
        whole_s = sum(sum(seconds.values()) for seconds in self.seconds)
        steps = ", ".join(f"{step} {value:.2f} s" for step, value in median.items())
        count = len(self.seconds)
        return [f"{count} moment{'s' * (count != 1)} in {clock(whole_s)}; of one, median: {steps}"]

    def _visit(self, drive: Drive, visit: Visit) -> str:
        """One lift; a line about it if its answer is wanted."""
        predictor, watch = self.predictor, Watch(self.predictor.device)
        if visit.reset:
            predictor.reset()
        with watch("read"):
            images, true_range_m = drive.images(visit.moment), drive.true_range_m(visit.moment)
        pose = None if drive.world_from_ego is None else drive.world_from_ego[visit.moment]
        answer = predictor.step(images, drive.rig, pose, true_range_m, watch)
        if not visit.wanted:
            return ""
        truth = drive.truth(visit.moment, predictor.model.geometry, self.unknown)
        with watch("write"):
            self._write(drive, visit.moment, images, answer, truth)
        scored = "" if truth is None else f"{self._score(answer.labels, truth)}; "
        self.seconds.append(watch.seconds)
        steps = ", ".join(f"{step} {value:.2f} s" for step, value in watch.seconds.items())
        occupied = int((answer.labels > 0).sum())
        return f"{self._folder(drive, visit.moment)}: {occupied} voxels; {scored}{steps}"

    def _write(
        self, drive: Drive, moment: int, images: Sequence[np.ndarray], answer: Answer, truth: Truth | None
    ) -> None:
        folder, geometry = self._folder(drive, moment), self.predictor.model.geometry
        folder.mkdir(parents=True, exist_ok=True)
        own = raised_grid(geometry, drive.origin_z_m)
        if self.mesh:
            write_mesh(folder, answer.labels, own, WORLD_CLASSES)
        if self.picture:
            panorama, caption = self.predictor.panorama, f"{drive.name} {drive.moments[moment]}".strip()
            missing = f", without {', '.join(self.predictor.without)}" * bool(self.predictor.without)
            ranges = None if panorama is None or answer.range_m is None else RangePanorama(panorama, answer.range_m)
            voxels = None if truth is None else truth.voxels
            sheet = occupancy_sheet(
                images,
                drive.rig,
                answer.labels,
                geometry,
                WORLD_CLASSES,
                ranges,
                voxels,
                f"{caption}{missing}".lstrip(", "),
            )
            save_png(folder / PICTURE, sheet)
        poses = drive.world_from_ego
        pose = None if poses is None else moved_origin(poses[moment], -drive.origin_z_m)
        write_voxels(folder, voxel_arrays(answer, own, pose))

    def _score_finished(self, drive: Drive, moment: int) -> None:
        truth = drive.truth(moment, self.predictor.model.geometry, self.unknown)
        if truth is not None:
            self._score(read_labels(self._folder(drive, moment), self.predictor.model.geometry), truth)

    def _score(self, labels: Tensor, truth: Truth) -> str:
        """Add a moment to the scores; its own in a few words."""
        assert self.scores is not None
        voxels = truth.voxels.unsqueeze(0)
        self.scores.update(labels.unsqueeze(0), truth.as_batch())
        alone = VoxelIoU(self.scores.num_classes)
        alone.update(labels.unsqueeze(0), voxels)
        own = alone.compute()
        return f"IoU {own['iou']:.3f}, mIoU {own['miou']:.3f}"

    def _folder(self, drive: Drive, moment: int) -> Path:
        return self.output / drive.name / drive.moments[moment]
