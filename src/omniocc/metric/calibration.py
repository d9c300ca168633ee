"""Calibration: whether predictions of a confidence are right as often as it says."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import torch
from jaxtyping import Bool, Float, Float64
from torch import Tensor

from rayiou.checks import Array, as_tensors, check_mask, check_real, hash_of
from rayiou.plot import new_axes, plot_scores
from rayiou.setting import CountMetric

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


class CalibrationError(CountMetric):
    """Expected calibration error, and a reliability diagram, over a dataset.

    Predictions are sorted by confidence into bins of equal width. Keys: `ece` (mean over the predictions of the
    difference between mean confidence and fraction right of their bin; Guo et al., On Calibration of Modern Neural
    Networks, ICML 2017, equation 3), `confidence` (mean) and `right` (fraction). Without predictions they are nan.

    Args:
        bins: number of bins.
        kwargs: those of every `torchmetrics.Metric`: `dist_sync_on_step`, `sync_on_compute` and so on.

    Raises:
        ValueError: if there is no bin.

    Example:
        >>> metric = CalibrationError()
        >>> metric.update(torch.tensor([0.9, 0.9, 0.5, 0.5]), torch.tensor([True, True, True, False]))
        >>> round(metric.compute()["ece"].item(), 3)
        0.05
    """

    higher_is_better = False
    plot_upper_bound = 1.0
    sums: Tensor

    def __init__(self, bins: int = 15, **kwargs: Any):
        super().__init__(**kwargs)
        if bins < 1:
            raise ValueError(f"bins must be at least 1, got {bins}")
        self.add_setting(hash_of(repr(bins).encode()))
        self.add_state("sums", torch.zeros(bins, 3, dtype=torch.float64), dist_reduce_fx="sum")

    def update(self, preds: Float[Array, "..."], target: Bool[Array, "..."]) -> None:
        """Add the confidences of predictions and whether each is right.

        Args:
            preds: confidences in [0, 1].
            target: whether the prediction is right.

        Raises:
            ValueError: naming a wrong shape, type or value.
        """
        preds, target = as_tensors(self.device, preds=preds, target=target)
        check_real("preds", preds)
        check_mask("target", target, preds.shape)
        said = preds.flatten().double()
        wrong = ~((said >= 0) & (said <= 1))
        if bool(wrong.any()):
            raise ValueError(f"preds must be confidences in [0, 1], got {said[wrong][0].item():g}")
        bins = len(self.sums)
        columns = torch.stack([torch.ones_like(said), said, target.flatten().double()], 1)
        # as in the definition, a bin holds its upper end and not its lower one
        self.sums = self.sums.index_add(0, ((said * bins).ceil().long() - 1).clamp(min=0), columns)

    def compute(self) -> dict[str, Tensor]:
        """Return the scores over all predictions."""
        count, said, right = self.sums.sum(0)
        gaps = (self.sums[:, 1] - self.sums[:, 2]).abs().sum()
        return {"ece": (gaps / count).float(), "confidence": (said / count).float(), "right": (right / count).float()}

    def reliability(self) -> Float64[Tensor, "bins 3"]:
        """Return fraction of all predictions, mean confidence and fraction right of each bin; nan where it is empty."""
        count = self.sums[:, :1]
        return torch.cat([count / count.sum(), self.sums[:, 1:] / count], 1)

    def plot(
        self, val: dict[str, Tensor] | Sequence[dict[str, Tensor]] | None = None, ax: "Axes | None" = None
    ) -> "tuple[Figure, Axes]":
        """Draw the reliability diagram: fraction right over confidence, each dot as large as its bin is full.

        A result of `compute` is drawn as bars instead, a list of results as lines.

        Raises:
            ImportError: without matplotlib.
        """
        if val is not None:
            return plot_scores(self, ["ece", "confidence", "right"], val, ax)
        axes = new_axes(4.0, 4.0) if ax is None else ax
        fraction, said, right = self.reliability().cpu().T.numpy()
        axes.plot([0, 1], [0, 1], color="#999999", linewidth=1, label="calibrated")
        axes.plot(said, right, color="#4c72b0", linewidth=1)
        axes.scatter(said, right, s=10 + 400 * fraction, color="#4c72b0", alpha=0.6)
        axes.set(xlim=(0, 1), ylim=(0, 1), xlabel="confidence", ylabel="fraction right", aspect="equal")
        axes.text(0.04, 0.92, f"ECE {float(self.compute()['ece']):.3f}")
        axes.spines[["top", "right"]].set_visible(False)
        figure = axes.figure
        assert figure is not None
        return figure, axes  # pyright: ignore[reportReturnType]
