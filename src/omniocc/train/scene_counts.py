"""Counts of rays of every scene of a test, from which the scores of any group of scenes follow later."""

from collections.abc import Iterator, Mapping
from pathlib import Path

import torch
from jaxtyping import UInt8
from torch import Tensor

from omniocc.batch import Batch
from omniocc.camera.plausible import kind_of
from omniocc.classes import UNKNOWN
from omniocc.data import SceneSource
from omniocc.data.store.reader import SceneReader
from omniocc.metric import RayTruth
from omniocc.runs.distributed import all_gather
from omniocc.runs.scenes import LIDAR, MOVING, RAYS, Counted, save_scenes
from omniocc.scores import Scores
from rayiou.ray_counts import RayCounts


class SceneCounts:
    """The counts of `Scores` apart by scene: rays against true voxels, LiDAR rays, and those that hit what moves.

    Nothing is counted where a dataset's own `Benchmark` is scored, nor rays against voxels from other origins than the
    ego's.

    Args:
        scores: of the test; its counters are used, its counts are not touched.
    """

    def __init__(self, scores: Scores):
        self.scores = scores
        self.counted: dict[str, Counted] = {}

    def update(self, labels: UInt8[Tensor, "B X Y Z"], batch: Batch) -> None:
        """Add a batch of predicted labels on the grid of the model."""
        if self.scores.benchmark is not None:
            return
        lidar = None if batch.lidar_labels is None else self.scores.lidar_truth(batch)
        for sample, frame_id in enumerate(batch.frame_ids):
            one = slice(sample, sample + 1)
            scene = self.counted.setdefault(frame_id.rpartition("/")[0], {})
            for kind, counts in self._counts(labels[one], batch, lidar, one):
                counts = self.scores.rays.counter.counts_at(counts, self.scores.rays.counter.thresholds_m)
                lines = torch.cat([counts.truth.sum(0)[None], counts.predicted.sum(0)[None], counts.correct.sum(0)])
                scene[kind] = added(scene.get(kind), lines.tolist())

    def reset(self) -> None:
        """Forget all counts."""
        self.counted = {}

    def of_all(self) -> dict[str, Counted]:
        """Return the counts of every scene, summed over all processes, which have to call this together."""
        found: dict[str, Counted] = {}
        for part in all_gather(self.counted):
            for name, counted in part.items():
                scene = found.setdefault(name, {})
                for kind, lines in counted.items():
                    scene[kind] = added(scene.get(kind), lines)
        return dict(sorted(found.items()))

    def _counts(
        self, labels: Tensor, batch: Batch, lidar: RayTruth | None, one: slice
    ) -> Iterator[tuple[str, RayCounts]]:
        if batch.voxels is not None and batch.ray_origins is None:
            seen = None if batch.scored is None else batch.scored[one]
            yield RAYS, self.scores.rays.counter.count(labels, batch.voxels[one], observed=seen)
        if lidar is None:
            return
        directions = None if lidar.directions is None else lidar.directions[one]
        starts = None if lidar.starts is None else lidar.starts[one]
        truth = RayTruth(lidar.range_m[one], lidar.labels[one], directions, starts)
        yield LIDAR, self.scores.lidar.counter.count(labels, truth)
        if batch.lidar_moving is not None:
            moving = truth.labels.masked_fill(~batch.lidar_moving[one], UNKNOWN)
            yield MOVING, self.scores.lidar.counter.count(labels, truth._replace(labels=moving))


def save_by_scene(folder: Path, scores: Scores, source: SceneSource, counted: Mapping[str, Counted]) -> None:
    """Write the counts of every test scene into the folder of a run, with weather and kind of place where recorded.

    Where scenes have different rigs, their kind is a condition, too.
    """
    if counted:
        scenes = [scene for scene in source.scenes("test") if isinstance(scene, SceneReader)]
        differ = len({scene.rigs[0].fingerprint for scene in scenes}) > 1
        rigs = {scene.name: {"rig": kind_of(scene.rigs[0])} if differ else {} for scene in scenes}
        conditions = {scene.name: scene.conditions | rigs[scene.name] for scene in scenes}
        save_scenes(folder, counted, conditions, source.spec.classes.names, scores.rays.counter.thresholds_m)


def added(before: list[list[int]] | None, lines: list[list[int]]) -> list[list[int]]:
    """Return the sum of two tables of counts."""
    if before is None:
        return lines
    return [[a + b for a, b in zip(*pair, strict=True)] for pair in zip(before, lines, strict=True)]
