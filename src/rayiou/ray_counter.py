"""Cast rays through predicted and true frames, and count the correct hits; nothing is kept between calls."""

from collections.abc import Sequence
from typing import Any, Literal, NamedTuple

import torch
from jaxtyping import Bool, Float, Int64, Shaped, UInt8
from torch import Tensor

from rayiou.bands import as_edges, num_rows
from rayiou.checks import (
    Array,
    as_tensors,
    check_grid,
    check_increasing,
    check_mask,
    check_origins,
    check_same_batch,
    hash_of,
)
from rayiou.class_ids import ClassIds
from rayiou.cuboid import Cuboid
from rayiou.cylinder import Cylinder
from rayiou.directions import sparseocc_directions
from rayiou.protocol import RaysSeen, dropped_text, error_text, free_text, mean_text, rays_text
from rayiou.ray_counts import TIMES, RayCounts, count_rays, occupied_score, ray_scores
from rayiou.raycast.fans import RayScan
from rayiou.raycast.table import RayTable, ray_table
from rayiou.raycast.trace import Hits

UNIT_TOLERANCE = 1e-3
"""By how much the length of a ray's direction may differ from 1."""


class RayTruth(NamedTuple):
    """Measurements of a real LiDAR: truth without a grid; see `RayIoU.update_rays`.

    Attributes:
        range_m: distance along each ray, inf for no hit; the rays are all directions of the metric from the first
            origin, then from the next. A ray whose range is nan or not above 0 did not come back: it is left out,
            whatever its label.
        labels: class of the surface hit; free for no hit.
        directions: unit rays of each frame, ego frame, in place of the metric's directions and origins.
        starts: where these rays start, m, ego frame; None: in the ego origin.
    """

    range_m: Float[Tensor, "B R"]
    labels: Shaped[Tensor, "B R"]
    directions: Float[Tensor, "B R 3"] | None = None
    starts: Float[Tensor, "B R 3"] | None = None


def tensors_of(
    device: torch.device | str,
    preds: Array,
    target: Array | RayTruth,
    origins: Array | None,
    observed: Array | None,
    origin_times: Array | None,
) -> tuple[Any, ...]:
    """Return the arguments of `RayCounter.count` as tensors; numpy arrays are copied to the device.

    Raises:
        ValueError: naming the argument that is no array of numbers.
    """
    preds, origins, observed = as_tensors(device, preds=preds, origins=origins, observed=observed)
    (times,) = as_tensors(device, origin_times=origin_times)
    if isinstance(target, RayTruth):
        return preds, RayTruth(*as_tensors(device, **target._asdict())), origins, observed, times
    return preds, *as_tensors(device, target=target), origins, observed, times


def scan_of(directions: Float[Array, "D 3"] | None) -> RayScan:
    """Return rays in these directions, ready to be cast from any origin; None: the directions of the public RayIoU."""
    if directions is None:
        return RayScan(sparseocc_directions())
    (given,) = as_tensors("cpu", directions=directions)
    return RayScan(given if given.is_floating_point() else given.double())


class RayCounter:
    """Counts the rays of RayIoU in given frames: it keeps no counts and does not communicate with other processes.

    Arguments and errors are those of `rayiou.RayIoU`, which sums the counts.
    """

    def __init__(
        self,
        grid: Cylinder | Cuboid,
        classes: ClassIds,
        thresholds_m: Sequence[float | int],
        range_edges_m: Sequence[float | int] | None,
        directions: Float[Array, "D 3"] | None,
        target_grid: Cylinder | Cuboid | None,
        hit: Literal["exit", "entry"],
        count_free_rays: bool,
        split_origins: bool = False,
        fine_thresholds_m: Sequence[float | int] = (),
    ):
        if hit not in ("exit", "entry"):
            raise ValueError(f"hit must be 'exit' or 'entry', got {hit!r}")
        self.grid, self.target_grid = grid, target_grid or grid
        check_grid("grid", self.grid)
        check_grid("target_grid", self.target_grid)
        self.classes = classes
        self.thresholds_m = tuple(float(threshold) for threshold in thresholds_m)
        self.fine_thresholds_m = tuple(float(threshold) for threshold in fine_thresholds_m)
        check_increasing("thresholds_m", self.thresholds_m, at_least=1)
        check_increasing("fine_thresholds_m", self.fine_thresholds_m, at_least=0)
        self.all_thresholds_m = tuple(sorted({*self.thresholds_m, *self.fine_thresholds_m}))
        self.range_edges_m = as_edges(range_edges_m)
        self.hit, self.count_free_rays, self.split_origins = hit, count_free_rays, split_origins
        self.public_rays = directions is None
        self.scan = scan_of(directions)

    def zero_counts(self) -> RayCounts:
        """Return the counts of no frames."""
        rows = num_rows(self.range_edges_m) * (len(TIMES) if self.split_origins else 1)
        zeros = torch.zeros(rows, self.classes.num_classes, dtype=torch.int64)
        correct = zeros.unsqueeze(1).repeat(1, len(self.all_thresholds_m), 1)
        return RayCounts(zeros, zeros.clone(), correct, correct[..., 0].clone())

    def count(
        self,
        preds: Shaped[Tensor, "B *grid"],
        target: Shaped[Tensor, "Bt *target_grid"] | RayTruth,
        origins: Float[Tensor, "*origins 3"] | None = None,
        observed: Shaped[Tensor, "Bo *observed_grid"] | None = None,
        origin_times: Shaped[Tensor, "*times"] | None = None,
    ) -> RayCounts:
        """Return the summed counts of a batch; arguments as in `RayIoU.update`.

        Raises:
            ValueError: naming a wrong shape, type or value.
        """
        preds = self.classes.check("preds", preds, self.grid.shape, truth=False)
        if origins is not None and (origins.ndim != 3 or len(origins) != len(preds) or origins.shape[2] != 3):
            raise ValueError(f"origins must have shape ({len(preds)}, O, 3), got {tuple(origins.shape)}")
        if origins is not None:
            check_origins("origins", origins)
        times = self._index_times(origins, origin_times, len(preds))
        origins = torch.zeros(1, 3).expand(len(preds), 1, 3) if origins is None else origins
        origins = origins.to(preds.device)
        if not origins.shape[1]:
            counts = []
        elif isinstance(target, RayTruth):
            if observed is not None:
                raise ValueError(
                    "observed is for true voxels; give the ignored class to measured rays that do not count"
                )
            counts = self._count_measured(preds, target, origins, times)
        else:
            target = self._ignore_unobserved(preds, target, observed)
            samples = zip(preds, target, origins, times, strict=True)
            counts = [self._count_voxels(*sample) for sample in samples]
        zero = (part.to(preds.device) for part in self.zero_counts())
        return RayCounts(*(torch.stack(parts).sum(0) for parts in zip(zero, *counts, strict=True)))

    def scores(self, counts: RayCounts) -> dict[str, Tensor]:
        """Return the scores of counts: see `rayiou.ray_counts.ray_scores` for the keys.

        The scores at the fine thresholds, if there are any, are `fine/rayiou` and `fine/rayiou@<threshold>`;
        `occupied/rayiou` is the score without classes.
        """
        scores = self._scores_at(counts, self.thresholds_m)
        whole = self.counts_at(counts, self.thresholds_m)
        scores["occupied/rayiou"] = occupied_score(whole, self.classes.occupied)
        fine = self._scores_at(counts, self.fine_thresholds_m) if self.fine_thresholds_m else {}
        keys = ("rayiou", *(f"rayiou@{threshold_m:g}" for threshold_m in self.fine_thresholds_m))
        return scores | {f"fine/{key}": fine[key] for key in keys if fine}

    def counts_at(self, counts: RayCounts, thresholds_m: Sequence[float]) -> RayCounts:
        """Return the counts at these thresholds alone, in their order."""
        places = [self.all_thresholds_m.index(threshold_m) for threshold_m in thresholds_m]
        return counts._replace(correct=counts.correct[:, places], struck=counts.struck[:, places])

    def _scores_at(self, counts: RayCounts, thresholds_m: Sequence[float]) -> dict[str, Tensor]:
        counts = self.counts_at(counts, thresholds_m)
        return ray_scores(counts, self.classes.occupied, thresholds_m, self.range_edges_m)

    def protocol(self, seen: RaysSeen) -> str:
        """Return one line on how the rays of all inputs so far (`seen`) are counted."""
        return "; ".join(
            (
                rays_text(len(self.scan), self.public_rays, seen),
                error_text(self.thresholds_m, self.fine_thresholds_m, self.hit, seen),
                dropped_text(self.classes, self.count_free_rays, seen.masked),
                mean_text(self.classes),
                *free_text(seen),
            )
        )

    def setting(self) -> UInt8[Tensor, "16"]:
        """Return a hash of all that decides what is counted: counts of metrics with equal hashes can be added."""
        grids, classes = (self.grid, self.target_grid), (self.classes.num_classes, self.classes.free)
        parts = (
            grids,
            classes,
            self.classes.ignored,
            self.thresholds_m,
            self.fine_thresholds_m,
            self.range_edges_m,
            self.hit,
        )
        text = repr((*parts, self.count_free_rays, self.split_origins)).encode()
        return hash_of(text + self.scan.directions.cpu().numpy().tobytes())

    def _index_times(
        self, origins: Tensor | None, origin_times: Tensor | None, batch: int
    ) -> Sequence[Int64[Tensor, " O"] | None]:
        """Return for each sample the index in `TIMES` of each origin; all None without `split_origins`."""
        if origin_times is not None and (origins is None or origin_times.shape != origins.shape[:2]):
            shape = "None without origins" if origins is None else tuple(origins.shape[:2])
            raise ValueError(f"origin_times must be {shape}, a time for each origin, got {tuple(origin_times.shape)}")
        if not self.split_origins:
            return [None] * batch
        if origins is not None and origin_times is None:
            raise ValueError("split_origins needs origin_times: when the car was at each of the origins")
        now = torch.ones(batch, 1, dtype=torch.int64)
        # signs -1, 0 and 1 become the indices of past, now and future
        return list(now if origin_times is None else origin_times.sign().long() + 1)

    def _ignore_unobserved(self, preds: Tensor, target: Tensor, observed: Tensor | None) -> Tensor:
        """Return the checked true labels; cells that are not `observed` get the ignored class."""
        target = self.classes.check("target", target, self.target_grid.shape, truth=True)
        check_same_batch("preds", preds, "target", target)
        check_mask("observed", observed, target.shape)
        return target if observed is None else target.masked_fill(~observed, self.classes.ignored)

    def _count_measured(
        self, preds: Tensor, target: RayTruth, origins: Tensor, times: Sequence[Tensor | None]
    ) -> list[RayCounts]:
        target = self._check_rays(preds, target, origins)
        if target.directions is None:
            samples = zip(preds, target.range_m, target.labels, origins, times, strict=True)
            return [self._count_shared_rays(*sample) for sample in samples]
        if self.count_free_rays:
            raise ValueError("count_free_rays needs rays that are the same in all frames")
        starts = torch.zeros_like(target.directions) if target.starts is None else target.starts
        rows = zip(preds, target.range_m, target.labels, target.directions, starts, strict=True)
        return [self._count_own_rays(*row) for row in rows]

    def _count_own_rays(
        self, preds: Tensor, range_m: Tensor, labels: Tensor, directions: Tensor, starts: Tensor
    ) -> RayCounts:
        """Return the counts of one frame that has its own R rays: `directions` and `starts` (R, 3)."""
        kept = (labels != self.classes.free) & (labels != self.classes.ignored) & range_m.isfinite()
        range_m, labels, directions, starts = range_m[kept].double(), labels[kept], directions[kept], starts[kept]
        # uint8 wraps around, as in `_cast`
        found = self.grid.cast(preds - self.classes.free, starts, directions)
        error_m = torch.maximum(found.entry_m - range_m, range_m - found.exit_m).clamp(min=0)
        inside = self.grid.index(starts.double() + directions.double() * range_m.unsqueeze(-1))[1]
        # the LiDAR was there when the frame was taken
        now = torch.tensor([TIMES.index("now")]) if self.split_origins else None
        return self._count(labels, range_m, found.labels + self.classes.free, error_m, inside, now)

    def _check_rays(self, preds: Tensor, target: RayTruth, origins: Tensor) -> RayTruth:
        """Return the checked measurements; rays that did not come back get the ignored class, whatever their label."""
        rays = len(self.scan) * origins.shape[1] if target.directions is None else target.directions.shape[1]
        lost, labels = ~(target.range_m > 0), target.labels  # nan is lost too, and nan <= 0 is false
        # lost rays may have any label: the check sees free instead
        measured = labels.masked_fill(lost, self.classes.free) if lost.shape == labels.shape else labels
        known = self.classes.check("labels", measured, (rays,), truth=True)
        check_same_batch("preds", preds, "labels", labels)
        if lost.shape != labels.shape:
            raise ValueError(f"range_m must have shape {tuple(labels.shape)}, got {tuple(lost.shape)}")
        target = target._replace(labels=known.masked_fill(lost, self.classes.ignored))
        shape = (*target.labels.shape, 3)
        for name, vectors in (("directions", target.directions), ("starts", target.starts)):
            if vectors is not None and vectors.shape != shape:
                raise ValueError(f"{name} must have shape {shape}, a vector for each ray, got {tuple(vectors.shape)}")
        if target.directions is None:
            return target
        if target.starts is not None:
            check_origins("starts", target.starts[target.labels != self.classes.ignored])
        lengths = target.directions.norm(dim=-1)[target.labels != self.classes.ignored]
        if not bool(((lengths - 1).abs() < UNIT_TOLERANCE).all()):
            raise ValueError(f"directions must be unit vectors, got lengths {lengths.min():.4g} to {lengths.max():.4g}")
        return target

    def _count_voxels(
        self, preds: Tensor, target: Tensor, origins: Float[Tensor, "O 3"], times: Int64[Tensor, " O"] | None
    ) -> RayCounts:
        if self.target_grid == self.grid:
            found, truth = self._cast(ray_table(self.grid, origins, self.scan), preds, target)
        else:
            found = self._cast(ray_table(self.grid, origins, self.scan), preds)[0]
            truth = self._cast(ray_table(self.target_grid, origins, self.scan), target)[0]
        free = truth.labels == self.classes.free
        valid = ~free
        if self.target_grid != self.grid:
            valid &= self._is_inside(origins, (truth.entry_m.double() + truth.exit_m) / 2)
        true_m, predicted_m = (hits.entry_m if self.hit == "entry" else hits.exit_m for hits in (truth, found))
        if self.count_free_rays:
            valid |= free & self._can_judge(found, truth.exit_m)
        return self._count(truth.labels, true_m, found.labels, (true_m - predicted_m).abs(), valid, times)

    def _count_shared_rays(
        self,
        preds: Tensor,
        range_m: Tensor,
        labels: Tensor,
        origins: Float[Tensor, "O 3"],
        times: Int64[Tensor, " O"] | None,
    ) -> RayCounts:
        table = ray_table(self.grid, origins, self.scan)
        found = self._cast(table, preds)[0]
        range_m, labels = range_m.double(), labels.to(torch.uint8)
        error_m = torch.maximum(found.entry_m - range_m, range_m - found.exit_m).clamp(min=0)
        valid = (labels != self.classes.free) & self._is_inside(origins, range_m)
        if self.count_free_rays:
            reach_m = table.reach_m
            free = ((labels == self.classes.free) | (range_m >= reach_m)) & (labels != self.classes.ignored)
            clear_m = torch.minimum(range_m, reach_m.double())
            valid |= free & self._can_judge(found, clear_m)
            labels, range_m = labels.masked_fill(free, self.classes.free), torch.where(free, clear_m, range_m)
        return self._count(labels, range_m, found.labels, error_m, valid, times)

    def _cast(self, table: RayTable, *volumes: Tensor) -> list[Hits]:
        # uint8 wraps around: the free class becomes 0, and no other class does
        hits = table.cast_all([labels - self.classes.free for labels in volumes])
        return [found._replace(labels=found.labels + self.classes.free) for found in hits]

    def _is_inside(self, origins: Float[Tensor, "O 3"], range_m: Float[Tensor, " R"]) -> Bool[Tensor, " R"]:
        """Return whether the points at these distances are in the prediction's grid."""
        starts, directions = self.scan.rays(origins)
        return self.grid.index(starts + directions * range_m.unsqueeze(-1))[1]

    def _can_judge(self, found: Hits, clear_m: Float[Tensor, " R"]) -> Bool[Tensor, " R"]:
        """Return which rays whose truth is free up to `clear_m` count.

        These are the rays that are predicted free, or to hit something nearer. A predicted hit beyond `clear_m` is
        neither right nor wrong: the truth there is not known.
        """
        return clear_m.isfinite() & ((found.labels == self.classes.free) | (found.entry_m < clear_m))

    def _count(
        self,
        true_labels: Tensor,
        true_m: Tensor,
        labels: Tensor,
        error_m: Tensor,
        valid: Tensor,
        times: Int64[Tensor, " O"] | None,
    ) -> RayCounts:
        """Return the counts of the rays, in the order: all from the first origin, then from the next.

        `times` has for each origin its index in `TIMES`.
        """
        valid = valid & (true_labels != self.classes.ignored)
        if times is not None:
            times = times.to(labels.device).repeat_interleave(len(labels) // max(1, len(times)))
        num_classes, edges_m = self.classes.num_classes, self.range_edges_m
        return count_rays(
            true_labels,
            true_m,
            labels,
            error_m,
            valid,
            num_classes,
            self.classes.free,
            thresholds_m=self.all_thresholds_m,
            range_edges_m=edges_m,
            times=times,
        )
