"""IoU of voxels, by counts over the whole dataset."""

import torch
from jaxtyping import Int64, Shaped
from torch import Tensor
from torchmetrics import Metric

from omniocc.classes import CLASSES, FREE, NUM_CLASSES, UNKNOWN
from omniocc.metric.checks import check_labels


def voxel_confusion(prediction: Shaped[Tensor, "..."], target: Shaped[Tensor, "..."]) -> Int64[Tensor, "12 12"]:
    """Counts voxels by true (row) and predicted (column) class; unknown (255) in the target does not count."""
    known = target != UNKNOWN
    keys = target[known].long() * NUM_CLASSES + prediction[known].long()
    return torch.bincount(keys, minlength=NUM_CLASSES**2).reshape(NUM_CLASSES, NUM_CLASSES)


def voxel_scores(confusion: Int64[Tensor, "12 12"]) -> dict[str, Tensor]:
    """Divides counts.

    Returns:
        `iou`, `precision` and `recall` of occupied against free; `iou/<class>` of the 11 occupied classes and `miou`,
        their mean over those that occur in truth or prediction. What has no cases is nan.
    """
    counts = confusion.double()
    both = counts.diagonal()
    classes = (both / (counts.sum(0) + counts.sum(1) - both))[FREE + 1 :]
    hit = counts[FREE + 1 :, FREE + 1 :].sum()
    missed, invented = counts[FREE + 1 :, FREE].sum(), counts[FREE, FREE + 1 :].sum()
    scores = {"iou": hit / (hit + missed + invented), "miou": classes.nanmean()}
    scores |= {"precision": hit / (hit + invented), "recall": hit / (hit + missed)}
    scores |= {f"iou/{CLASSES[FREE + 1 + i].name}": value for i, value in enumerate(classes)}
    return {key: value.float() for key, value in scores.items()}


class VoxelIoU(Metric):
    """IoU of classes and of occupancy; counts are summed over dataset and processes before anything is divided."""

    is_differentiable = False
    higher_is_better = True
    full_state_update = False
    confusion: Tensor

    def __init__(self):
        super().__init__()
        self.add_state("confusion", torch.zeros(NUM_CLASSES, NUM_CLASSES, dtype=torch.int64), dist_reduce_fx="sum")

    def update(self, prediction: Shaped[Tensor, "B X Y Z"], target: Shaped[Tensor, "Bt Xt Yt Zt"]) -> None:
        """Adds predicted and true class ids of a batch.

        Args:
            prediction: class of every cell.
            target: true class of every cell, or 255 for unknown, which does not count.

        Raises:
            ValueError: naming a wrong shape, type or value.
        """
        if prediction.shape != target.shape:
            sizes = f"{tuple(prediction.shape)} and {tuple(target.shape)}"
            raise ValueError(f"prediction and target must have the same shape, got {sizes}")
        shape = tuple(target.shape[1:])
        self.confusion += voxel_confusion(
            check_labels("prediction", prediction, shape, NUM_CLASSES),
            check_labels("target", target, shape, NUM_CLASSES, UNKNOWN),
        )

    def compute(self) -> dict[str, Tensor]:
        """Scores over everything seen: see `voxel_scores` for the keys."""
        return voxel_scores(self.confusion)
