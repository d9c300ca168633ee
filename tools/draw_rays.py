"""Rays that cross a cylinder: `python tools/draw_rays.py docs/pictures/rays.png` (needs matplotlib)."""

import math
import sys
from typing import TYPE_CHECKING

import torch
from jaxtyping import UInt8
from torch import Tensor

from omniocc.geometry import Cylinder
from omniocc.metric import sparseocc_directions

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COARSE = Cylinder((8, 24, 1), (0.0, 16.0), (-1.0, 1.0))
ORIGINS_M = ((-12.0, -10.5, 0.0), (10.0, 8.0, 0.0), (-13.0, 2.6, 0.0))
DIRECTIONS = ((1.0, 0.75, 0.0), (-0.2, -1.0, 0.0), (13.0, -2.6, 0.0))
COLORS = ("tab:blue", "tab:orange", "tab:green")
HIT = (5, 8, 0)
"""The occupied cell of `COARSE`, which the second ray hits."""


def occupied() -> UInt8[Tensor, "X Y Z"]:
    """Return labels of `COARSE` with one occupied cell."""
    labels = torch.zeros(COARSE.shape, dtype=torch.uint8)
    labels[HIT] = 4
    return labels


def draw_cell(axes: "Axes", grid: Cylinder, cell: int, color: str, alpha: float) -> None:
    """Fill one cell, seen from above; x is up and y is left, as the ego faces forward."""
    r, theta = cell // (grid.shape[1] * grid.shape[2]), cell // grid.shape[2] % grid.shape[1]
    radius_m, angle = grid.edges(0)[r : r + 2], grid.edges(1)[theta : theta + 2]
    arc = torch.linspace(float(angle[0]), float(angle[1]), 9, dtype=torch.float64)
    rim = torch.cat([radius_m[0] * torch.exp(1j * arc), radius_m[1] * torch.exp(1j * arc.flip(0))])
    axes.fill((-rim.imag).tolist(), rim.real.tolist(), color=color, alpha=alpha, linewidth=0)


def draw_grid(axes: "Axes", grid: Cylinder) -> None:
    """Draw rings and sectors."""
    turn = torch.linspace(0, 2 * math.pi, 241)
    for radius_m in grid.edges(0).tolist():
        axes.plot((radius_m * turn.sin()).tolist(), (radius_m * turn.cos()).tolist(), color="0.75", linewidth=0.6)
    for angle in grid.edges(1)[:-1].tolist():
        ends = [(-radius_m * math.sin(angle), radius_m * math.cos(angle)) for radius_m in grid.radius_m]
        axes.plot(*zip(*ends, strict=True), color="0.75", linewidth=0.6)


def draw_crossings(axes: "Axes") -> None:
    """Draw rays with the cells that they cross, and where they enter and leave the occupied one."""
    origins, directions = torch.tensor(ORIGINS_M), torch.nn.functional.normalize(torch.tensor(DIRECTIONS), dim=1)
    found, hits = COARSE.paths(origins, directions), COARSE.cast(occupied(), origins, directions)
    draw_grid(axes, COARSE)
    draw_cell(axes, COARSE, int(occupied().argmax()), "0.25", 0.9)
    for ray, color in enumerate(COLORS):
        crossed = found.cells[ray][found.cells[ray] >= 0].tolist()
        for cell in crossed:
            draw_cell(axes, COARSE, cell, color, 0.22)
        ends_m = found.bounds_m[ray][: len(crossed) + 1]
        at = origins[ray] + ends_m.unsqueeze(1) * directions[ray]
        axes.plot((-at[:, 1]).tolist(), at[:, 0].tolist(), ".-", color=color, markersize=5, linewidth=1)
        if hits.labels[ray]:
            for range_m, style in ((hits.entry_m[ray], "o"), (hits.exit_m[ray], "s")):
                x, y, _ = (origins[ray] + range_m * directions[ray]).tolist()
                axes.plot(-y, x, style, markersize=9, markerfacecolor="white", markeredgecolor=color)
    axes.set(aspect="equal", xticks=[], yticks=[], title="Cells crossed, seen from above (forward is up)")
    axes.spines[:].set_visible(False)


def draw_elevations(axes: "Axes") -> None:
    """Draw the 39 elevations from the side, on the paper's grid: the ten lowest hit the road at equal steps."""
    grid = Cylinder()
    labels = torch.zeros(grid.shape, dtype=torch.uint8)
    labels[:, :, :2] = 1
    directions = sparseocc_directions()[::360]
    hits = grid.cast(labels, torch.zeros_like(directions), directions)
    axes.axhspan(grid.height_m[0], float(grid.edges(2)[2]), color="0.85")
    for direction, label, entry_m, exit_m in zip(directions, hits.labels, hits.entry_m, hits.exit_m, strict=True):
        color = "tab:red" if label else "0.6"
        x, _, z = direction.tolist()
        axes.plot([0, x * float(entry_m)], [0, z * float(entry_m)], color=color, linewidth=0.7)
        if label:
            axes.plot(x * float(exit_m), z * float(exit_m), "s", color=color, markersize=3)
    axes.set(xlim=(0, 27), ylim=(-3, 3.8), xlabel="x (m)", ylabel="z (m)", title="The 39 elevations; road in grey")


def main(path: str) -> None:
    """Write the image."""
    import matplotlib

    matplotlib.use("agg")
    from matplotlib import pyplot

    figure, (above, side) = pyplot.subplots(1, 2, figsize=(12, 5), width_ratios=(1, 1.3), layout="constrained")
    draw_crossings(above)
    draw_elevations(side)
    figure.savefig(path, dpi=110)
    pyplot.close(figure)


if __name__ == "__main__":
    main(sys.argv[1])
