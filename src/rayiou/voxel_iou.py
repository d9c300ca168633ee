"""IoU, precision and recall of voxels, from sums over the whole dataset."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import torch
from jaxtyping import Bool, Float64, Shaped, UInt8
from torch import Tensor

from rayiou.checks import Array, as_tensors, check_grid, check_mask, check_same_shape, hash_of
from rayiou.class_ids import ClassIds
from rayiou.cuboid import Cuboid
from rayiou.cylinder import Cylinder
from rayiou.labels import FREE, NUM_CLASSES, UNKNOWN
from rayiou.plot import Colors, plot_scores
from rayiou.protocol import cells_text
from rayiou.setting import CountMetric

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def voxel_confusion(
    prediction: UInt8[Tensor, "B X Y Z"],
    target: UInt8[Tensor, "B X Y Z"],
    counted: Bool[Tensor, "B X Y Z"],
    num_classes: int,
    weights: Float64[Tensor, "X Y Z"] | None = None,
) -> Float64[Tensor, "C C"]:
    """Return the sums of counted voxels, or of their weights, by true (row) and predicted (column) class."""
    keys = target[counted].long() * num_classes + prediction[counted]
    weights = None if weights is None else weights.to(keys.device).expand(counted.shape)[counted]
    return torch.bincount(keys, weights, minlength=num_classes**2).double().reshape(num_classes, num_classes)


def voxel_scores(confusion: Float64[Tensor, "C C"], free_index: int, occupied: Mapping[int, str]) -> dict[str, Tensor]:
    """Return the scores of sums (`voxel_confusion`); `occupied` has the names by id of all classes but free.

    Returns:
        In float64: `iou`, `precision`, `recall` and `f1` of occupied against free; `iou/<class>` of the occupied
        classes, and `miou`, their mean over those that occur in truth or prediction. A score without cases is nan.
    """
    correct, ids = confusion.diagonal(), list(occupied)
    classes = correct / (confusion.sum(0) + confusion.sum(1) - correct)
    found = confusion[ids][:, ids].sum()
    missed, hallucinated = confusion[ids, free_index].sum(), confusion[free_index, ids].sum()
    scores = {"iou": found / (found + missed + hallucinated), "miou": classes[ids].nanmean()}
    scores |= {"precision": found / (found + hallucinated), "recall": found / (found + missed)}
    scores["f1"] = 2 * found / (2 * found + missed + hallucinated)
    scores |= {f"iou/{name}": classes[c] for c, name in occupied.items()}
    return scores


class VoxelIoU(CountMetric):
    """IoU of classes, and IoU, precision, recall and F1 of occupancy; see `voxel_scores` for the keys.

    Scores are ratios of sums over the dataset and all processes.

    Args:
        num_classes: number of classes, free included.
        free_index: id of free space.
        ignore_index: id of unknown cells in the target, which do not count.
        grid: grid whose cell volumes weigh the cells. The cells of a cylinder grow with their distance, so scores
            of a cylinder and of a cuboid are comparable only by volume. Default: every cell counts once.
        class_names: names by id, for the keys; default the ids.
        kwargs: those of every `torchmetrics.Metric`: `dist_sync_on_step`, `sync_on_compute` and so on.

    Raises:
        ValueError: naming the argument that is wrong.

    Example:
        >>> target = torch.zeros(1, 4, 4, 2, dtype=torch.uint8)
        >>> target[:, :2] = 1
        >>> metric = VoxelIoU()
        >>> metric.update(target.roll(1, dims=1), target)
        >>> {key: round(value.item(), 2) for key, value in metric.compute().items() if not value.isnan()}
        {'iou': 0.33, 'miou': 0.33, 'precision': 0.5, 'recall': 0.5, 'f1': 0.5, 'iou/1': 0.33}
    """

    higher_is_better = True
    plot_upper_bound = 1.0
    confusion: Tensor
    masked: Tensor

    def __init__(
        self,
        num_classes: int = NUM_CLASSES,
        free_index: int = FREE,
        ignore_index: int = UNKNOWN,
        grid: Cylinder | Cuboid | None = None,
        class_names: Sequence[str] | None = None,
        **kwargs: Any,
    ):
        super().__init__(**kwargs)
        self.classes = ClassIds(num_classes, free_index, ignore_index, class_names)
        if grid is not None:
            check_grid("grid", grid)
        self.grid = grid
        self.add_setting(hash_of(repr((num_classes, free_index, ignore_index, grid)).encode()))
        self.add_state("confusion", torch.zeros(num_classes, num_classes, dtype=torch.float64), dist_reduce_fx="sum")
        self.add_state("masked", torch.zeros((), dtype=torch.uint8), dist_reduce_fx="max")

    def update(
        self,
        preds: Shaped[Array, "B X Y Z"],
        target: Shaped[Array, "Bt Xt Yt Zt"],
        observed: Bool[Array, "Bt Xt Yt Zt"] | None = None,
    ) -> None:
        """Add predicted and true class ids of a batch.

        Args:
            preds: class of every cell; any integer type, or whole numbers in a floating one.
            target: true class of every cell, or `ignore_index`.
            observed: cells that count; default all. Unknown cells never count.

        Raises:
            ValueError: naming a wrong shape, type or value.
        """
        preds, target, observed = as_tensors(self.device, preds=preds, target=target, observed=observed)
        check_same_shape("preds", preds, "target", target)
        shape = tuple(target.shape[1:]) if self.grid is None else self.grid.shape
        preds = self.classes.check("preds", preds, shape, truth=False)
        target = self.classes.check("target", target, shape, truth=True)
        check_mask("observed", observed, target.shape)
        known = target != self.classes.ignored
        counted = known if observed is None else observed & known
        weights = None if self.grid is None else self.grid.volumes_m3()
        self.confusion = self.confusion + voxel_confusion(preds, target, counted, self.classes.num_classes, weights)
        if observed is not None:
            self.masked = torch.ones_like(self.masked)

    def compute(self) -> dict[str, Tensor]:
        """Return the scores over all frames: see `voxel_scores` for the keys."""
        scores = voxel_scores(self.confusion, self.classes.free, self.classes.occupied)
        return {key: value.float() for key, value in scores.items()}

    def protocol(self) -> str:
        """Return which cells of what it was given this process counted, and how, in one line."""
        return cells_text(self.classes, self.grid is not None, bool(self.masked))

    def plot(
        self,
        val: dict[str, Tensor] | Sequence[dict[str, Tensor]] | None = None,
        ax: "Axes | None" = None,
        colors: Colors | None = None,
    ) -> "tuple[Figure, Axes]":
        """Draw the IoU of every class: bars for a result of `compute` (default: now), lines for a list of results.

        It needs matplotlib. `colors` are RGB, 0 to 255, of bars by the name of their class.
        """
        return plot_scores(self, [f"iou/{name}" for name in self.classes.occupied.values()], val, ax, colors)
