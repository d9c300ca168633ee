"""IoU, precision and recall of voxels, by sums over the whole dataset."""

from typing import TYPE_CHECKING

import torch
from jaxtyping import Bool, Float64, Shaped, UInt8
from torch import Tensor
from torchmetrics import Metric

from omniocc.classes import CLASSES, FREE, NUM_CLASSES, UNKNOWN
from omniocc.geometry import Cuboid, Cylinder
from omniocc.metric.checks import check_classes, check_labels, check_mask
from omniocc.metric.plot import plot_bars

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
    """Sums voxels, or their weights, by true (row) and predicted (column) class.

    Args:
        prediction: class of every cell.
        target: true class of every cell.
        counted: cells that count.
        num_classes: number of classes, free included.
        weights: of every cell; default 1.
    """
    keys = target[counted].long() * num_classes + prediction[counted]
    chosen = None if weights is None else weights.to(keys.device).expand(counted.shape)[counted]
    return torch.bincount(keys, chosen, minlength=num_classes**2).double().reshape(num_classes, num_classes)


def voxel_scores(confusion: Float64[Tensor, "C C"], free_class: int = FREE) -> dict[str, Tensor]:
    """Divides sums.

    Returns:
        `iou`, `precision`, `recall` and `f1` of occupied against free; `iou/<class>` of the occupied classes, and
        `miou`, their mean over those that occur in truth or prediction. What has no cases is nan.
    """
    both = confusion.diagonal()
    classes = both / (confusion.sum(0) + confusion.sum(1) - both)
    occupied = [c for c in range(len(confusion)) if c != free_class]
    found = confusion[occupied][:, occupied].sum()
    missed, invented = confusion[occupied, free_class].sum(), confusion[free_class, occupied].sum()
    scores = {"iou": found / (found + missed + invented), "miou": classes[occupied].nanmean()}
    scores |= {"precision": found / (found + invented), "recall": found / (found + missed)}
    scores["f1"] = 2 * found / (2 * found + missed + invented)
    known = len(confusion) == NUM_CLASSES
    scores |= {f"iou/{CLASSES[c].name if known else c}": classes[c] for c in occupied}
    return {key: value.float() for key, value in scores.items()}


class VoxelIoU(Metric):
    """IoU of classes, and IoU, precision, recall and F1 of occupancy; see `voxel_scores` for the keys.

    Sums over dataset and processes are taken before anything is divided.

    Args:
        num_classes: number of classes, free included.
        free_class: id of free space.
        ignore_class: id of unknown cells in the target, which do not count.
        geometry: count every cell by its volume in this grid. The cells of a cylinder grow with their distance, so
            that scores of a cylinder and of a cuboid compare only by volume. Default: every cell counts once.

    Raises:
        ValueError: if the ids make no sense.

    Example:
        >>> target = torch.zeros(1, 4, 4, 2, dtype=torch.uint8)
        >>> target[:, :2] = 1
        >>> metric = VoxelIoU()
        >>> metric.update(target.roll(1, dims=1), target)
        >>> {key: round(value.item(), 2) for key, value in metric.compute().items() if not value.isnan()}
        {'iou': 0.33, 'miou': 0.33, 'precision': 0.5, 'recall': 0.5, 'f1': 0.5, 'iou/Road': 0.33}
    """

    is_differentiable = False
    higher_is_better = True
    full_state_update = False
    confusion: Tensor

    def __init__(
        self,
        num_classes: int = NUM_CLASSES,
        free_class: int = FREE,
        ignore_class: int = UNKNOWN,
        geometry: Cylinder | Cuboid | None = None,
    ):
        super().__init__()
        check_classes(num_classes, free_class, ignore_class)
        self.num_classes, self.free_class, self.ignore_class = num_classes, free_class, ignore_class
        self.geometry = geometry
        self.add_state("confusion", torch.zeros(num_classes, num_classes, dtype=torch.float64), dist_reduce_fx="sum")

    def update(
        self,
        prediction: Shaped[Tensor, "B X Y Z"],
        target: Shaped[Tensor, "Bt Xt Yt Zt"],
        observed: Bool[Tensor, "Bt Xt Yt Zt"] | None = None,
    ) -> None:
        """Adds predicted and true class ids of a batch.

        Args:
            prediction: class of every cell; any integer type, or whole numbers in a floating one.
            target: true class of every cell, or `ignore_class`.
            observed: cells that count; default all that are not unknown.

        Raises:
            ValueError: naming a wrong shape, type or value.
        """
        if prediction.shape != target.shape:
            sizes = f"{tuple(prediction.shape)} and {tuple(target.shape)}"
            raise ValueError(f"prediction and target must have the same shape, got {sizes}")
        shape = tuple(target.shape[1:]) if self.geometry is None else self.geometry.shape
        prediction = check_labels("prediction", prediction, shape, self.num_classes)
        target = check_labels("target", target, shape, self.num_classes, self.ignore_class)
        check_mask("observed", observed, target.shape)
        counted = target != self.ignore_class if observed is None else observed & (target != self.ignore_class)
        weights = None if self.geometry is None else self.geometry.volumes_m3()
        self.confusion += voxel_confusion(prediction, target, counted, self.num_classes, weights)

    def compute(self) -> dict[str, Tensor]:
        """Scores over everything seen: see `voxel_scores` for the keys."""
        return voxel_scores(self.confusion, self.free_class)

    def plot(self, val: dict[str, Tensor] | None = None, ax: "Axes | None" = None) -> "tuple[Figure, Axes]":
        """Draws the IoU of every class as bars (needs matplotlib): of what `compute` returned, default now."""
        scores = self.compute() if val is None else val
        return plot_bars(scores, [key for key in scores if key.startswith("iou/")], ax)
