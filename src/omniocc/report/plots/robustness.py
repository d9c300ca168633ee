"""Plot of a robustness test: the drop of every system to every disturbance."""

import math
from collections.abc import Sequence

from matplotlib import colormaps, rc_context
from matplotlib.figure import Figure as Canvas

from omniocc.report.plots.figures import STYLE, WHISKER
from omniocc.report.tables.robustness import names_of
from omniocc.runs.robustness import Robustness, drop_of


@rc_context(STYLE)
def drops(records: Sequence[Robustness]) -> Canvas:
    """Draw the drop of RayIoU by disturbance, a bar for each system; whiskers are standard errors over scenes."""
    names = list(dict.fromkeys(part.part for record in records for part in record.disturbed))
    height = 0.84 / len(records)
    canvas = Canvas(figsize=(8.6, 1.0 + max(0.2, 0.13 * len(records)) * len(names)), layout="constrained")
    axes = canvas.subplots()
    for number, (record, label) in enumerate(zip(records, names_of(records), strict=True)):
        found = {part.part: drop_of(part, record.undisturbed) for part in record.disturbed}
        places = [names.index(name) - 0.42 + (number + 0.5) * height for name in found]
        errors = [0.0 if math.isnan(drop.error) else drop.error for drop in found.values()]
        color = colormaps["tab10"].colors[number % 10]  # type: ignore[attr-defined]
        values = [drop.value for drop in found.values()]
        axes.barh(places, values, height * 0.92, color=color, label=label)
        axes.errorbar(values, places, xerr=errors, fmt="none", **WHISKER)
    axes.set_yticks(range(len(names)), names)
    axes.invert_yaxis()
    axes.tick_params(axis="y", length=0, labelsize=8)
    axes.grid(axis="y", visible=False)
    axes.set_xlabel("drop of RayIoU (whiskers: standard error over scenes)")
    canvas.legend(loc="outside upper left", ncols=4, fontsize=9)
    return canvas
