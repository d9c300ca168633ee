"""RayIoU: occupancy scored by the first hits of LiDAR rays (SparseOcc, Liu et al. 2024), on any grid."""

from collections.abc import Sequence
from dataclasses import astuple
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import torch
from jaxtyping import Bool, Float, Int64, Shaped
from torch import Tensor

from rayiou.bands import band_suffixes, num_rows
from rayiou.checks import Array
from rayiou.class_ids import ClassIds
from rayiou.cuboid import Cuboid
from rayiou.cylinder import Cylinder
from rayiou.labels import FREE, NUM_CLASSES, UNKNOWN
from rayiou.plot import Colors, plot_scores
from rayiou.protocol import RaysSeen
from rayiou.ray_counter import RayCounter, RayTruth, tensors_of
from rayiou.ray_counts import TIMES, RayCounts
from rayiou.setting import CountMetric

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


class RayIoU(CountMetric):
    """RayIoU over a dataset, counted as in the public protocol.

    A ray counts if its true first hit is of a class other than free and unknown. It is correct at a threshold if the
    predicted first hit has the same class and is at a distance that differs by less than the threshold. Counts are
    summed over rays, frames and processes; IoU = correct / (true + predicted - correct) for each class and threshold,
    and the mean runs over thresholds and over the classes present. A ray that misses the grid is invalid (the
    public script takes voxel (0, 0, 0) for it).

    The paper does not state its thresholds, rays and origins. The default here is the mean over 1, 2 and 4 m of
    the public 39 x 360 rays from the ego origin. Range bands refer to the true distance along the ray.
    `docs/rayiou.md` compares this with the public script.

    Args:
        grid: grid of the predictions.
        num_classes: number of classes, free included.
        free_index: id of free space.
        ignore_index: id of unknown cells in the target; rays whose true first hit is unknown are dropped.
        thresholds_m: distance errors that count as correct, each strictly below; the mean runs over these.
        range_edges_m: ends of the range bands; None for no bands.
        directions: (D, 3) rays in the ego frame; default `sparseocc_directions()`.
        target_grid: grid of the targets; default `grid`. Rays whose true hit is outside the prediction's grid
            are dropped.
        hit: distance of a hit: where the ray leaves the cell hit (the public protocol) or where it enters it.
        count_free_rays: also count rays whose truth is free, at the distance at which the ray leaves the grid, so that
            a class predicted on them loses IoU. The public protocol drops them: hallucinations cost nothing.
        class_names: names by id, for the keys; default the ids.
        split_origins: also score the rays from where the car was before, at and after the scored frame apart
            (`rayiou_past`, `rayiou_now`, `rayiou_future`); `update` then takes the times of its origins.
        fine_thresholds_m: a second set of distance errors, scored apart from the same rays as `fine/rayiou` (its mean)
            and `fine/rayiou@<threshold>`; empty for none. ParkOcc's are .25, .5 and 1 m.
        kwargs: those of every `torchmetrics.Metric`: `dist_sync_on_step`, `sync_on_compute`, `process_group` and so on.

    Raises:
        ValueError: naming the argument that is wrong.

    Example:
        >>> import torch
        >>> grid = Cylinder((32, 50, 4), (0.0, 12.8), (-2.8, 3.6))
        >>> target = torch.zeros(1, 32, 50, 4, dtype=torch.uint8)
        >>> target[..., 0] = 1
        >>> target[:, 26] = 4  # a round building, 10.4 to 10.8 m away
        >>> metric = RayIoU(grid)
        >>> metric.update(target.roll(3, dims=1), target)  # found 1.2 m too far
        >>> [round(metric.compute()[key].item(), 2) for key in ("rayiou", "rayiou@1", "rayiou@2", "rayiou/4")]
        [0.77, 0.44, 0.93, 0.65]
    """

    __jit_unused_properties__: ClassVar[list[str]] = [*CountMetric.__jit_unused_properties__, "seen"]
    higher_is_better = True
    plot_upper_bound = 1.0
    truth: Tensor
    predicted: Tensor
    correct: Tensor
    struck: Tensor
    inputs: Tensor
    measured: Tensor

    def __init__(
        self,
        grid: Cylinder | Cuboid,
        num_classes: int = NUM_CLASSES,
        free_index: int = FREE,
        ignore_index: int = UNKNOWN,
        thresholds_m: Sequence[float | int] = (1.0, 2.0, 4.0),
        range_edges_m: Sequence[float | int] | None = None,
        directions: Float[Array, "D 3"] | None = None,
        target_grid: Cylinder | Cuboid | None = None,
        hit: Literal["exit", "entry"] = "exit",
        count_free_rays: bool = False,
        class_names: Sequence[str] | None = None,
        split_origins: bool = False,
        fine_thresholds_m: Sequence[float | int] = (),
        **kwargs: Any,
    ):
        super().__init__(**kwargs)
        classes = ClassIds(num_classes, free_index, ignore_index, class_names)
        self.counter = RayCounter(
            grid,
            classes,
            thresholds_m,
            range_edges_m,
            directions,
            target_grid,
            hit=hit,
            count_free_rays=count_free_rays,
            split_origins=split_origins,
            fine_thresholds_m=fine_thresholds_m,
        )
        self.add_setting(self.counter.setting())
        for name, counts in self.counter.zero_counts()._asdict().items():
            self.add_state(name, counts, dist_reduce_fx="sum")
        self.add_state("inputs", torch.tensor(astuple(RaysSeen()), dtype=torch.int64), dist_reduce_fx="max")
        self.add_state("measured", torch.zeros(3, dtype=torch.int64), dist_reduce_fx="sum")

    def update(
        self,
        preds: Shaped[Array, "B *grid"],
        target: Shaped[Array, "Bt *target_grid"] | RayTruth,
        origins: Float[Array, "*origins 3"] | None = None,
        observed: Shaped[Array, "Bo *observed_grid"] | None = None,
        origin_times: Shaped[Array, "*times"] | None = None,
    ) -> None:
        """Add predicted and true class ids of a batch.

        Args:
            preds: (B, *grid.shape) class of every cell; any integer type, or whole numbers in a floating one.
            target: (B, *target_grid.shape) true class of every cell, or `ignore_index`; or the measured rays of
                `update_rays`.
            origins: (B, O, 3) starts of the rays, ego frame, metres; default the ego origin. `trajectory_origins` gives
                those of the public protocol.
            observed: bool, shape of the target: cells that count; the others are unknown.
            origin_times: (B, O) when the car was at the origins: below 0 before the scored frame, 0 at it, above 0
                after it, in any unit; `split_origins` needs them.

        Raises:
            ValueError: naming a wrong shape, type or value.
        """
        inputs = tensors_of(self.device, preds, target, origins, observed, origin_times)
        preds, target, origins, observed, origin_times = inputs
        counts = self.counter.count(*inputs)
        self.truth = self.truth + counts.truth
        self.predicted = self.predicted + counts.predicted
        self.correct = self.correct + counts.correct
        self.struck = self.struck + counts.struck
        measured, number = isinstance(target, RayTruth), 0 if origins is None else origins.shape[1]
        if measured:
            self.measured = self.measured + _measured(target, self.counter.classes.ignored, counts)
        own_rays = measured and target.directions is not None
        seen = RaysSeen(True, measured, own_rays, number, origin_times is not None, observed is not None)
        self.inputs = torch.maximum(self.inputs, self.inputs.new_tensor(astuple(seen)))

    def update_rays(
        self,
        preds: Shaped[Array, "B X Y Z"],
        range_m: Float[Array, "B R"],
        labels: Shaped[Array, "B R"],
        origins: Float[Array, "B O 3"] | None = None,
    ) -> None:
        """Add predicted class ids of a batch against the measurements of a real LiDAR, whose truth has no grid.

        An occupied voxel does not locate the surface inside it, so the error of a ray is the distance from the true
        range to the segment of the ray inside the predicted cell: 0 if the true point is in it. (`hit` applies to
        voxels against voxels only, where both sides have the same bias.) A ray without a hit, or with a point outside
        the grid, has free truth and is dropped unless `count_free_rays`; no truth is available behind its point.

        Args:
            preds: class of every cell.
            range_m: see `RayTruth`.
            labels: see `RayTruth`.
            origins: as in `update`.

        Raises:
            ValueError: naming a wrong shape, type or value.
        """
        self.update(preds, RayTruth(range_m, labels), origins)

    def compute(self) -> dict[str, Tensor]:
        """Return the scores over all frames: those of `RayCounter.scores`."""
        return self.counter.scores(RayCounts(self.truth, self.predicted, self.correct, self.struck))

    @property
    def seen(self) -> RaysSeen:
        """Return what this process was given since it was made or reset."""
        return RaysSeen(*self.inputs.tolist())

    def left_out(self) -> dict[str, Tensor]:
        """Return the fraction of the measured rays that do not count, over all frames and processes.

        Keys: `left_out`, of which `left_out_unknown` are those to surfaces of unknown class, and `left_out_free` those
        whose truth is free: rays without a return or with a point outside of the grid. Without measured rays: nan.
        """
        synced = self._is_synced
        with self.sync_context(self.dist_sync_fn, should_sync=self._to_sync and not synced, should_unsync=not synced):
            rays, unknown, counted = self.measured.double()
        parts = {"": rays - counted, "_unknown": unknown, "_free": rays - counted - unknown}
        return {f"left_out{end}": (part / rays).float() for end, part in parts.items()}

    def protocol(self) -> str:
        """Return how this process counted what it was given: rays, origins, thresholds, masks and classes, in one line.

        Two scores on the same grid and rays are comparable if these lines are equal: rays from other origins give one
        network another score (docs/rayiou.md, Origins).
        """
        return self.counter.protocol(self.seen)

    def compute_within(self) -> dict[str, Tensor]:
        """Return `rayiou_within_<range>m` of the rays from the first end of the bands up to each of the others.

        These are nested ranges: each holds the nearer ones.
        """
        edges_m, found = self.counter.range_edges_m, {}
        band = torch.arange(len(self.truth), device=self.truth.device) % num_rows(edges_m)  # apart by origin or not
        for bands, end_m in enumerate(edges_m[1:], start=1):
            parts = (self.truth, self.predicted, self.correct, self.struck)
            near = RayCounts(*(part * (band < bands).view(-1, *[1] * (part.ndim - 1)) for part in parts))
            found[f"rayiou_within_{end_m:g}m"] = self.counter.scores(near)["rayiou"]
        return found

    @classmethod
    def sparseocc(cls, grid: Cylinder | Cuboid, num_classes: int = 18, **options: Any) -> "RayIoU":
        """Return the metric in the published setting, that of Occ3D in SparseOcc's script.

        The last class is free, 255 is unknown, 14,040 rays start in every origin, and a hit is right below 1, 2 or 4 m.
        OpenOcc has 17 classes. Other arguments as in the class; `update` takes the origins
        (https://github.com/MCG-NJU/SparseOcc).
        """
        return cls(grid, num_classes, num_classes - 1, **options)

    def plot(
        self,
        val: dict[str, Tensor] | Sequence[dict[str, Tensor]] | None = None,
        ax: "Axes | None" = None,
        by: Literal["class", "threshold", "range", "origin"] = "class",
        colors: Colors | None = None,
    ) -> "tuple[Figure, Axes]":
        """Draw scores as bars, or those of several steps as lines (needs matplotlib).

        Args:
            val: a result of `compute` or `forward`, or a list of them; default the current one.
            ax: axes to draw on; default a new figure.
            by: one bar or line for each class, threshold, range band or kind of origin.
            colors: RGB, 0 to 255, of bars by the name of their class.
        """
        ends = {
            "class": [f"/{name}" for name in self.counter.classes.occupied.values()],
            "threshold": [f"@{threshold_m:g}" for threshold_m in self.counter.thresholds_m],
            "range": band_suffixes(self.counter.range_edges_m),
            "origin": [f"_{name}" for name in TIMES] if self.counter.split_origins else [],
        }[by]
        return plot_scores(self, [f"rayiou{end}" for end in ends], val, ax, colors)


def _measured(target: RayTruth, ignored: int, counts: RayCounts) -> Int64[Tensor, "3"]:
    """Return the numbers of measured rays: all, those to unknown surfaces, and those that count."""
    unknown = target.labels == ignored
    absent = unknown & ~target.range_m.isfinite()  # fills the places of frames with fewer rays
    return torch.stack([(~absent).sum(), (unknown & ~absent).sum(), counts.truth.sum()])


def ray_iou(
    preds: Shaped[Array, "B X Y Z"],
    target: Shaped[Array, "B Xt Yt Zt"] | RayTruth,
    grid: Cylinder | Cuboid,
    origins: Float[Array, "B O 3"] | None = None,
    observed: Bool[Array, "B Xt Yt Zt"] | None = None,
    num_classes: int = NUM_CLASSES,
    free_index: int = FREE,
    ignore_index: int = UNKNOWN,
    thresholds_m: Sequence[float | int] = (1.0, 2.0, 4.0),
    range_edges_m: Sequence[float | int] | None = None,
    directions: Float[Array, "D 3"] | None = None,
    target_grid: Cylinder | Cuboid | None = None,
    hit: Literal["exit", "entry"] = "exit",
    count_free_rays: bool = False,
    class_names: Sequence[str] | None = None,
    split_origins: bool = False,
    origin_times: Shaped[Array, "B O"] | None = None,
    fine_thresholds_m: Sequence[float | int] = (),
) -> dict[str, Tensor]:
    """Return the RayIoU of these frames; see `RayIoU` for the definition, the arguments and the keys.

    In a distributed run each process gets the scores of its frames, without communication; one process may call it
    alone.

    Example:
        >>> import torch
        >>> grid = Cylinder((8, 16, 4), (0.0, 8.0), (-2.0, 2.0))
        >>> target = torch.zeros(1, 8, 16, 4, dtype=torch.uint8)
        >>> target[:, 4] = 4
        >>> level = torch.eye(3)[:2]
        >>> ray_iou(target.roll(1, dims=1), target, grid, directions=level, thresholds_m=(1.5,))["rayiou"].item()
        1.0
        >>> ray_iou(target.roll(1, dims=1), target, grid, directions=level, thresholds_m=(0.5,))["rayiou"].item()
        0.0
    """
    classes = ClassIds(num_classes, free_index, ignore_index, class_names)
    counter = RayCounter(
        grid,
        classes,
        thresholds_m,
        range_edges_m,
        directions,
        target_grid,
        hit=hit,
        count_free_rays=count_free_rays,
        split_origins=split_origins,
        fine_thresholds_m=fine_thresholds_m,
    )
    return counter.scores(counter.count(*tensors_of("cpu", preds, target, origins, observed, origin_times)))
