"""Counts of hits by class and the scores from them, as pure functions of rays, without grids."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float, Int64, UInt8
from torch import Tensor

from omniocc.metric.bands import band_of, band_suffixes, num_rows


class RayCounts(NamedTuple):
    """Numbers of rays by range band, threshold and class; counts of several frames add up.

    The first axis has a row for each band and a last one for all other distances.

    Attributes:
        truth: rays whose true class is c.
        predicted: rays whose predicted class is c.
        correct: rays of class c in both, with an error below the threshold.
    """

    truth: Int64[Tensor, "bands classes"]
    predicted: Int64[Tensor, "bands classes"]
    correct: Int64[Tensor, "bands thresholds classes"]


def count_rays(
    true_labels: UInt8[Tensor, " R"], true_m: Float[Tensor, " R"], predicted_labels: UInt8[Tensor, " R"],
    error_m: Float[Tensor, " R"], valid: Bool[Tensor, " R"], num_classes: int, thresholds_m: Sequence[float],
    range_edges_m: Sequence[float],
) -> RayCounts:  # fmt: skip
    """Return the counts of the rays that are `valid`.

    A ray's true distance decides its band, [lower, upper). It is correct if true and predicted class (free for no hit)
    are equal and the distance between both hits along the ray, `error_m`, is strictly below the threshold.
    """
    rows = num_rows(range_edges_m)
    first = band_of(true_m[valid], range_edges_m) * num_classes
    true_labels, predicted_labels, error_m = true_labels[valid].long(), predicted_labels[valid].long(), error_m[valid]

    def table(keys: Tensor) -> Tensor:
        return torch.bincount(keys, minlength=rows * num_classes).reshape(rows, num_classes)

    same = true_labels == predicted_labels
    correct = [table((first + true_labels)[same & (error_m < threshold_m)]) for threshold_m in thresholds_m]
    return RayCounts(table(first + true_labels), table(first + predicted_labels), torch.stack(correct, dim=1))


def ray_scores(
    counts: RayCounts, occupied: Mapping[int, str], thresholds_m: Sequence[float], range_edges_m: Sequence[float]
) -> dict[str, Tensor]:
    """Return the scores of counts: IoU of class c at a threshold = correct / (truth + predicted - correct).

    Classes that occur neither in the truth nor in the prediction are nan and left out of every mean.

    `occupied` has the names by id of the classes that are scored: all but free.

    Returns:
        `rayiou` (mean over thresholds and classes), `rayiou@<threshold>`, `rayiou/<class>` and
        `rayiou_<lower>-<upper>m`.
    """
    ids = list(occupied)
    whole = _iou(RayCounts(*(part.sum(0, keepdim=True) for part in counts)))[0][:, ids]
    scores = {"rayiou": whole.nanmean()}
    scores |= {f"rayiou@{t:g}": row.nanmean() for t, row in zip(thresholds_m, whole, strict=True)}
    scores |= {f"rayiou/{name}": column.nanmean() for name, column in zip(occupied.values(), whole.T, strict=True)}
    for row, suffix in zip(_iou(counts), band_suffixes(range_edges_m), strict=False):  # the last row is no band
        scores[f"rayiou{suffix}"] = row[:, ids].nanmean()
    return {key: value.float() for key, value in scores.items()}


def _iou(counts: RayCounts) -> Float[Tensor, "bands thresholds classes"]:
    union = (counts.truth + counts.predicted).unsqueeze(1) - counts.correct
    return counts.correct.double() / union.double()
