"""Counting and dividing for RayIoU: no grids here, only what rays found."""

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float, Int64, UInt8
from torch import Tensor


class RayCounts(NamedTuple):
    """Rays by range bin, threshold and class; counts of several frames add up.

    The bins are those between the given edges and a last one for all other distances.

    Attributes:
        truth: rays whose true class is c.
        predicted: rays whose predicted class is c.
        correct: rays of class c in both, closer than the threshold.
    """

    truth: Int64[Tensor, "bins classes"]
    predicted: Int64[Tensor, "bins classes"]
    correct: Int64[Tensor, "bins thresholds classes"]


def count_rays(
    true_labels: UInt8[Tensor, " R"],
    true_m: Float[Tensor, " R"],
    predicted_labels: UInt8[Tensor, " R"],
    error_m: Float[Tensor, " R"],
    valid: Bool[Tensor, " R"],
    num_classes: int,
    thresholds_m: Sequence[float],
    range_edges_m: Sequence[float],
) -> RayCounts:
    """Counts valid rays.

    Args:
        true_labels: class of the true hit.
        true_m: distance of the true hit, which decides the bin: [lower, upper).
        predicted_labels: class of the predicted hit, the free class for none.
        error_m: distance between the true and the predicted hit along the ray.
        valid: rays that count.
        num_classes: number of classes, free included.
        thresholds_m: errors strictly below count as correct.
        range_edges_m: ends of the range bins, increasing; may be empty.
    """
    bins = max(len(range_edges_m) - 1, 0)
    edges = torch.tensor(list(range_edges_m) or [0.0], dtype=torch.float64, device=true_m.device)
    place = torch.bucketize(true_m[valid].double(), edges, right=True) - 1
    place = torch.where((place >= 0) & (place < bins), place, bins) * num_classes
    true_labels, predicted_labels, error_m = true_labels[valid].long(), predicted_labels[valid].long(), error_m[valid]

    def table(keys: Tensor) -> Tensor:
        return torch.bincount(keys, minlength=(bins + 1) * num_classes).reshape(bins + 1, num_classes)

    same = true_labels == predicted_labels
    correct = [table((place + true_labels)[same & (error_m < threshold_m)]) for threshold_m in thresholds_m]
    return RayCounts(table(place + true_labels), table(place + predicted_labels), torch.stack(correct, dim=1))


def ray_scores(
    counts: RayCounts,
    class_names: Sequence[str],
    free_class: int,
    thresholds_m: Sequence[float],
    range_edges_m: Sequence[float],
) -> dict[str, Tensor]:
    """Divides: IoU of class c at a threshold = correct / (truth + predicted - correct).

    Classes that occur neither in the truth nor in the prediction are nan and left out of every mean; free is never part
    of one.

    Returns:
        `rayiou` (mean over thresholds and classes), `rayiou@<threshold>`, `rayiou/<class>` and
        `rayiou_<lower>-<upper>m`.
    """
    occupied = [c for c in range(len(class_names)) if c != free_class]
    whole = _iou(RayCounts(*(part.sum(0, keepdim=True) for part in counts)))[0][:, occupied]
    scores = {"rayiou": whole.nanmean()}
    scores |= {f"rayiou@{t:g}": row.nanmean() for t, row in zip(thresholds_m, whole, strict=True)}
    scores |= {f"rayiou/{class_names[c]}": column.nanmean() for c, column in zip(occupied, whole.T, strict=True)}
    for i, (low, high) in enumerate(itertools.pairwise(range_edges_m)):
        scores[f"rayiou_{low:g}-{high:g}m"] = _iou(counts)[i][:, occupied].nanmean()
    return {key: value.float() for key, value in scores.items()}


def _iou(counts: RayCounts) -> Float[Tensor, "bins thresholds classes"]:
    union = (counts.truth + counts.predicted).unsqueeze(1) - counts.correct
    return counts.correct.double() / union.double()
