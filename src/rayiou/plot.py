"""Bar charts of scores; the only part of the metrics that needs matplotlib."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from torch import Tensor
from torchmetrics import Metric

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

DEFAULT_COLOR = "#4c72b0"


Colors = Mapping[str, Sequence[int]]
"""RGB, 0 to 255, by the label of a bar."""


def plot_bars(
    scores: Mapping[str, Tensor], keys: list[str], ax: "Axes | None" = None, colors: Colors | None = None
) -> "tuple[Figure, Axes]":
    """Draw a bar for each score in `keys`, from 0 to 1; scores that are nan have no bar.

    Args:
        scores: the result of `compute`.
        keys: the scores to draw, in order. The part after a slash is the label of the bar.
        ax: axes to draw on; default a new figure.
        colors: of the bars that have one of their own.

    Raises:
        ImportError: without matplotlib.
        ValueError: if `keys` is empty.
    """
    if not keys:
        raise ValueError(f"no scores with these keys; available: {', '.join(scores)}")
    axes = new_axes(max(4.0, 0.6 * len(keys)), 3.5) if ax is None else ax
    own = {name: tuple(part / 255 for part in rgb) for name, rgb in (colors or {}).items()}
    names = [key.rsplit("/", 1)[-1] for key in keys]
    values = [float(scores[key]) for key in keys]
    bars = axes.bar(names, values, color=[own.get(name, DEFAULT_COLOR) for name in names])
    axes.bar_label(bars, labels=["" if value != value else f"{value:.3f}" for value in values], fontsize=8)
    axes.set_ylim(0, 1)
    axes.tick_params(axis="x", rotation=45 if len(keys) > 4 else 0)
    axes.spines[["top", "right"]].set_visible(False)
    figure = axes.figure
    assert figure is not None
    return figure, axes  # pyright: ignore[reportReturnType]


def new_axes(width: float, height: float) -> "Axes":
    """Return the axes of a new figure of this size, inches.

    Raises:
        ImportError: without matplotlib.
    """
    try:
        from matplotlib import pyplot
    except ImportError as error:
        raise ImportError("plot() needs matplotlib: pip install matplotlib") from error
    return pyplot.subplots(figsize=(width, height), layout="constrained")[1]


def plot_scores(
    metric: Metric,
    keys: list[str],
    val: dict[str, Tensor] | Sequence[dict[str, Tensor]] | None,
    ax: "Axes | None",
    colors: Colors | None = None,
) -> "tuple[Figure, Axes]":
    """Draw scores of a metric: bars for one result of `compute` (default: now), lines for a list of results.

    Raises:
        ImportError: without matplotlib.
        ValueError: if `keys` is empty.
    """
    if val is None or isinstance(val, Mapping):
        return plot_bars(metric.compute() if val is None else val, keys, ax, colors)
    # torchmetrics returns no figure for axes that were given
    figure, axes = metric._plot([{key: result[key] for key in keys} for result in val], ax)
    return (axes.figure if figure is None else figure), axes  # type: ignore[return-value]
