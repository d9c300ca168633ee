"""Counts of hits by class and the scores from them, as pure functions of rays, without grids."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float, Int64, UInt8
from torch import Tensor

from rayiou.bands import band_of, band_suffixes, num_rows

TIMES = ("past", "now", "future")
"""Kinds of origins, if they are scored apart: where the car was before, at and after the scored frame."""


class RayCounts(NamedTuple):
    """Numbers of rays by range band, threshold and class; counts of several frames add up.

    The first axis has a row for each band and a last one for all other distances; of rays whose origins are scored
    apart, these rows for each of `TIMES`, one after the other.

    Attributes:
        truth: rays whose true class is c.
        predicted: rays whose predicted class is c.
        correct: rays of class c in both, with an error below the threshold.
        struck: rays that hit something in both, of whatever classes, with an error below the threshold.
    """

    truth: Int64[Tensor, "rows classes"]
    predicted: Int64[Tensor, "rows classes"]
    correct: Int64[Tensor, "rows thresholds classes"]
    struck: Int64[Tensor, "rows thresholds"]


def count_rays(
    true_labels: UInt8[Tensor, " R"],
    true_m: Float[Tensor, " R"],
    predicted_labels: UInt8[Tensor, " R"],
    error_m: Float[Tensor, " R"],
    valid: Bool[Tensor, " R"],
    num_classes: int,
    free_index: int,
    thresholds_m: Sequence[float],
    range_edges_m: Sequence[float],
    times: Int64[Tensor, " R"] | None = None,
) -> RayCounts:
    """Return the counts of the rays that are `valid`.

    A ray's true distance decides its band, [lower, upper). It is correct if true and predicted class (free for no hit)
    are equal and the distance between both hits along the ray, `error_m`, is strictly below the threshold. `times` has
    the kind of origin of each ray, an index of `TIMES`; None: they are not scored apart.
    """
    rows = num_rows(range_edges_m)
    row = band_of(true_m[valid], range_edges_m)
    if times is not None:
        row, rows = row + times[valid] * rows, rows * len(TIMES)
    first = row * num_classes
    true_labels, predicted_labels, error_m = true_labels[valid].long(), predicted_labels[valid].long(), error_m[valid]

    def table(keys: Tensor) -> Tensor:
        return torch.bincount(keys, minlength=rows * num_classes).reshape(rows, num_classes)

    same = true_labels == predicted_labels
    both = (true_labels != free_index) & (predicted_labels != free_index)
    near = [error_m < threshold_m for threshold_m in thresholds_m]
    correct = [table((first + true_labels)[same & close]) for close in near]
    struck = [torch.bincount(row[both & close], minlength=rows) for close in near]
    truth, predicted = table(first + true_labels), table(first + predicted_labels)
    return RayCounts(truth, predicted, torch.stack(correct, dim=1), torch.stack(struck, dim=1))


def ray_scores(
    counts: RayCounts, occupied: Mapping[int, str], thresholds_m: Sequence[float], range_edges_m: Sequence[float]
) -> dict[str, Tensor]:
    """Return the scores of counts: IoU of class c at a threshold = correct / (truth + predicted - correct).

    Classes that occur neither in the truth nor in the prediction are nan and left out of every mean.

    `occupied` has the names by id of the classes that are scored: all but free.

    Returns:
        `rayiou` (mean over thresholds and classes), `rayiou@<threshold>`, `rayiou/<class>`,
        `rayiou_<lower>-<upper>m`, and `rayiou_past`, `rayiou_now`, `rayiou_future` if origins are counted apart.
    """
    ids = list(occupied)
    whole = _iou(RayCounts(*(part.sum(0, keepdim=True) for part in counts)))[0][:, ids]
    scores = {"rayiou": whole.nanmean()}
    scores |= {f"rayiou@{t:g}": row.nanmean() for t, row in zip(thresholds_m, whole, strict=True)}
    scores |= {f"rayiou/{name}": column.nanmean() for name, column in zip(occupied.values(), whole.T, strict=True)}
    by_time = [part.unflatten(0, (-1, num_rows(range_edges_m))) for part in counts]
    bands = _iou(RayCounts(*(part.sum(0) for part in by_time)))
    for row, suffix in zip(bands, band_suffixes(range_edges_m), strict=False):  # the last row is no band
        scores[f"rayiou{suffix}"] = row[:, ids].nanmean()
    times = _iou(RayCounts(*(part.sum(1) for part in by_time)))
    if len(times) == len(TIMES):
        scores |= {f"rayiou_{name}": row[:, ids].nanmean() for name, row in zip(TIMES, times, strict=True)}
    return {key: value.float() for key, value in scores.items()}


def occupied_score(counts: RayCounts, occupied: Mapping[int, str]) -> Float[Tensor, ""]:
    """Return RayIoU without classes: all but free are one class. Nan if nothing is hit, in the truth or predicted."""
    truth, predicted = (part.sum(0)[list(occupied)].sum() for part in counts[:2])
    struck = counts.struck.sum(0).double()
    return (struck / (truth + predicted - struck)).nanmean().float()


def _iou(counts: RayCounts) -> Float[Tensor, "rows thresholds classes"]:
    union = (counts.truth + counts.predicted).unsqueeze(1) - counts.correct
    return counts.correct.double() / union.double()
