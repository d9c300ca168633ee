"""Errors of predicted ranges, in metres and in indices of spheres of inverse range."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import torch
from jaxtyping import Bool, Float, Float64
from torch import Tensor

from rayiou.bands import as_edges, band_of, band_suffixes, num_rows
from rayiou.checks import Array, as_tensors, check_increasing, check_mask, check_real, check_same_shape, hash_of
from rayiou.plot import plot_scores
from rayiou.setting import CountMetric

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

NAMES = (
    *("mae", "absrel", "rmse", "delta1", "delta2", "delta3"),
    *("index_mae", "index_rmse", "index>1", "index>3", "index>5"),
)
"""Quantities averaged over rays; the root of the mean squared errors is taken afterwards."""


def sphere_index(
    range_m: Float[Tensor, "..."], nearest_m: float, farthest_m: float, spheres: int
) -> Float[Tensor, "..."]:
    """Return the real-valued index of ranges among spheres of equal steps in inverse range.

    0 is the farthest sphere, `spheres - 1` the nearest, as omnidirectional stereo samples space (OmniMVS, Won et al.
    2019, whose farthest sphere is at infinity).
    """
    step = (1 / nearest_m - 1 / farthest_m) / (spheres - 1)
    return (1 / range_m - 1 / farthest_m) / step


def depth_sums(
    preds: Float64[Tensor, " R"],
    target: Float64[Tensor, " R"],
    nearest_m: float,
    farthest_m: float,
    spheres: int,
) -> Float64[Tensor, "R sums"]:
    """Return the errors of every ray (predicted and true range, m), in the order of `NAMES`."""
    error_m = (preds - target).abs()
    ratio = torch.maximum(preds / target, target / preds)
    predicted, true = (sphere_index(range_m, nearest_m, farthest_m, spheres) for range_m in (preds, target))
    percent = (predicted - true).abs() / spheres * 100
    parts = [error_m, error_m / target, error_m**2, *(ratio < 1.25**k for k in (1, 2, 3))]
    parts += [percent, percent**2, *(percent > k for k in (1, 3, 5))]
    return torch.stack([part.double() for part in parts], dim=-1)


def depth_scores(
    sums: Float64[Tensor, "bands sums"], count: Float64[Tensor, " bands"], edges_m: Sequence[float]
) -> dict[str, Tensor]:
    """Return the scores of sums over rays; see `DepthMetrics` for the keys. A score without rays is nan."""
    means = torch.cat([sums.sum(0, keepdim=True) / count.sum(), sums / count.unsqueeze(1)])
    means[:, [NAMES.index("rmse"), NAMES.index("index_rmse")]] **= 0.5
    scores = dict(zip(NAMES, means[0], strict=True))
    for row, suffix in zip(means[1:], band_suffixes(edges_m), strict=False):  # the last row is no band
        scores |= {f"{name}{suffix}": value for name, value in zip(NAMES, row, strict=True)}
    return {key: value.float() for key, value in scores.items()}


class DepthMetrics(CountMetric):
    """Errors of predicted ranges over a dataset.

    Rays count whose true range is between the nearest and the farthest sphere; those of the sky do not. Predictions
    are clamped to that interval. Keys: `mae` and `rmse` (m), `absrel`, `delta1`..`delta3` (fraction of rays with a
    ratio below 1.25^k), `index_mae`, `index_rmse` (percent of the number of spheres) and `index>1`, `index>3`,
    `index>5` (fraction of rays with an index error above that percentage, after OmniMVS); with `_<lower>-<upper>m` the
    same for each range band.

    Args:
        nearest_m: range of the nearest sphere.
        farthest_m: range of the farthest sphere; may be infinite.
        spheres: number of spheres.
        range_edges_m: ends of bands of the true range; None for no bands.
        kwargs: those of every `torchmetrics.Metric`: `dist_sync_on_step`, `sync_on_compute` and so on.

    Raises:
        ValueError: naming the argument that is wrong.

    Example:
        >>> metric = DepthMetrics(nearest_m=1.0, farthest_m=50.0)
        >>> metric.update(torch.tensor([10.0, 22.0, 5.0]), torch.tensor([10.0, 20.0, float("inf")]))
        >>> round(metric.compute()["mae"].item(), 3), round(metric.compute()["absrel"].item(), 3)
        (1.0, 0.05)
    """

    higher_is_better = False
    sums: Tensor
    count: Tensor

    def __init__(
        self,
        nearest_m: float = 0.5,
        farthest_m: float = float("inf"),
        spheres: int = 192,
        range_edges_m: Sequence[float | int] | None = None,
        **kwargs: Any,
    ):
        super().__init__(**kwargs)
        check_increasing("nearest_m and farthest_m", (float(nearest_m), float(farthest_m)), at_least=2)
        if nearest_m <= 0 or spheres < 2:
            raise ValueError(f"nearest_m must be above 0 and spheres at least 2, got {nearest_m} and {spheres}")
        self.nearest_m, self.farthest_m, self.spheres = float(nearest_m), float(farthest_m), spheres
        self.range_edges_m = as_edges(range_edges_m)
        rows = num_rows(self.range_edges_m)
        self.add_setting(hash_of(repr((self.nearest_m, self.farthest_m, spheres, self.range_edges_m)).encode()))
        self.add_state("sums", torch.zeros(rows, len(NAMES), dtype=torch.float64), dist_reduce_fx="sum")
        self.add_state("count", torch.zeros(rows, dtype=torch.float64), dist_reduce_fx="sum")

    def update(
        self, preds: Float[Array, "..."], target: Float[Array, "..."], observed: Bool[Array, "..."] | None = None
    ) -> None:
        """Add predicted and true ranges along the same rays.

        Args:
            preds: predicted ranges in metres, above 0.
            target: true ranges in metres; inf for the sky, which does not count.
            observed: rays that count; default all with a true range.

        Raises:
            ValueError: naming a wrong shape, type or value.
        """
        preds, target, observed = as_tensors(self.device, preds=preds, target=target, observed=observed)
        check_real("preds", preds)
        check_real("target", target)
        check_same_shape("preds", preds, "target", target)
        check_mask("observed", observed, target.shape)
        counted = (target >= self.nearest_m) & (target <= self.farthest_m) & target.isfinite()
        counted = counted if observed is None else counted & observed
        predicted, true = preds[counted].double(), target[counted].double()
        wrong = ~(predicted > 0) | (predicted.clamp(max=self.farthest_m) == float("inf"))
        if bool(wrong.any()):
            hint = "; give a finite farthest_m to clamp to" if self.farthest_m == float("inf") else ""
            raise ValueError(f"preds must be ranges above 0, got {predicted[wrong][0].item()}{hint}")
        predicted = predicted.clamp(self.nearest_m, self.farthest_m)
        errors = depth_sums(predicted, true, self.nearest_m, self.farthest_m, self.spheres)
        band = band_of(true, self.range_edges_m)
        self.sums = self.sums.index_add(0, band, errors)
        self.count = self.count.index_add(0, band, torch.ones_like(true))

    def compute(self) -> dict[str, Tensor]:
        """Return the scores over all rays."""
        return depth_scores(self.sums, self.count, self.range_edges_m)

    def plot(
        self, val: dict[str, Tensor] | Sequence[dict[str, Tensor]] | None = None, ax: "Axes | None" = None
    ) -> "tuple[Figure, Axes]":
        """Draw the scores that are fractions of rays: bars for a result of `compute` (default: now), lines for a list.

        It needs matplotlib.
        """
        return plot_scores(self, [name for name in NAMES if "delta" in name or ">" in name], val, ax)
