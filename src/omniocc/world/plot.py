"""Plots of land along the streets: what a town consists of behind its sidewalks."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from omniocc.world import building, tree, vehicle
from omniocc.world.barrier import PIECE_M
from omniocc.world.material import Material
from omniocc.world.mesh import Mesh, concatenate
from omniocc.world.shape import Color, Skin, box
from omniocc.world.site import Pose2, Site
from omniocc.world.stock import Stock, one, pick
from omniocc.world.theme import Theme


@dataclass(frozen=True)
class Plot:
    """A rectangle whose front edge lies behind the sidewalk.

    `front` is the middle of that edge; its x runs along the street and its y into the plot.
    """

    site: Site
    theme: Theme
    stock: Stock
    rng: np.random.Generator
    front: Pose2
    width_m: float
    depth_m: float

    def tree(self, x_m: float, y_m: float, kinds: dict[str, float] | None = None) -> None:
        """Plants a tree (or bush) of the theme."""
        kind = pick(self.rng, kinds or self.theme.trees)
        color = tree.LEAF_COLORS[int(self.rng.integers(len(tree.LEAF_COLORS)))]
        pose = self.front.at(x_m, y_m, float(self.rng.uniform(0, 2 * np.pi)))
        scale = float(self.rng.uniform(0.8, 1.2))
        self.site.put(one(self.rng, self.stock.trees[kind]), pose, scale=scale, material=Material.LEAVES, color=color)

    def line(self, pieces: list[Mesh], start: tuple[float, float], end: tuple[float, float]) -> None:
        """Sets equal pieces of a fence, wall or hedge end to end."""
        run = np.subtract(end, start)
        count, yaw = int(np.hypot(*run) / PIECE_M), float(np.arctan2(run[1], run[0]))
        piece = one(self.rng, pieces)
        color = tree.LEAF_COLORS[int(self.rng.integers(3))]
        for k in range(count):
            x, y = np.asarray(start) + run * (k + 0.5) / max(count, 1)
            self.site.put(piece, self.front.at(float(x), float(y), yaw), material=Material.LEAVES, color=color)

    def stand(self, mesh: Mesh, x_m: float, y_m: float, yaw_rad: float = 0.0) -> None:
        """Stands a thing on the plot."""
        self.site.put(mesh, self.front.at(x_m, y_m, yaw_rad))

    def car(self, x_m: float, y_m: float, yaw_rad: float) -> None:
        """Parks a car."""
        color = vehicle.PAINTS[int(self.rng.integers(len(vehicle.PAINTS)))]
        self.site.put(
            one(self.rng, self.stock.cars), self.front.at(x_m, y_m, yaw_rad), material=Material.CAR_PAINT, color=color
        )

    def colors(self) -> tuple[Color, Color]:
        """A wall's and a roof's."""
        walls, roofs = self.theme.wall_colors, self.theme.roof_colors
        return walls[int(self.rng.integers(len(walls)))], roofs[int(self.rng.integers(len(roofs)))]


def _tower(plot: Plot) -> None:
    back = float(plot.rng.uniform(*plot.theme.setback_m))
    deep = min(plot.depth_m - back - 0.6, float(plot.rng.uniform(11, 17)))
    plot.stand(building.tower(plot.rng, plot.width_m - 0.8, deep, *plot.colors()), 0, back)
    if back > 3.5:
        for x in np.arange(-plot.width_m / 2 + 2, plot.width_m / 2 - 1, 6):
            plot.tree(float(x), 1.2, {"bush": 3, "young": 1})


def _row(plot: Plot) -> None:
    back = float(plot.rng.uniform(plot.theme.setback_m[0], 0.6 * plot.theme.setback_m[1]))
    count = max(1, round(plot.width_m / 8))
    wide = (plot.width_m - 0.6) / count
    deep = min(plot.depth_m - back - 0.5, float(plot.rng.uniform(9, 12)))
    for k in range(count):
        plot.stand(building.row(plot.rng, wide, deep, *plot.colors()), (k + 0.5 - count / 2) * wide, back)
    if back > 2.5:
        kind = ("brick", "picket", "mesh")[int(plot.rng.integers(3))]
        for a, b in ((-0.5, -0.12), (0.12, 0.5)):
            plot.line(plot.stock.barriers[kind], (a * plot.width_m, 0.3), (b * plot.width_m, 0.3))


def _boundary(plot: Plot, gate: tuple[float, float]) -> None:
    """Fence, wall or hedge along the front (open at the gate) and one side."""
    half = plot.width_m / 2
    kind = pick(plot.rng, {"hedge": 3, "picket": 2, "brick": 1.5, "mesh": 1, "none": 2})
    pieces = plot.stock.hedges if kind == "hedge" else plot.stock.barriers.get(kind)
    if pieces:
        plot.line(pieces, (-half, 0.5), (gate[0], 0.5))
        plot.line(pieces, (gate[1], 0.5), (half, 0.5))
    side = plot.stock.hedges if plot.rng.uniform() < 0.4 else plot.stock.barriers["board"]
    plot.line(side, (half - 0.1, 3.0), (half - 0.1, plot.depth_m - 0.5))


def _house(plot: Plot) -> None:
    rng, half = plot.rng, plot.width_m / 2
    back = float(rng.uniform(*plot.theme.setback_m))
    wide, deep = (
        min(float(rng.uniform(8, 12.5)), plot.width_m - 5.5),
        min(float(rng.uniform(7.5, 10.5)), plot.depth_m - back - 1),
    )
    wall, roof = plot.colors()
    side = -1.0 if rng.uniform() < 0.5 else 1.0
    drive = side * (half - 2.2)
    plot.stand(building.house(rng, wide, deep, wall, roof), -side * (half - wide / 2 - 0.9), back)
    if half * 2 - wide > 5.2 and rng.uniform() < 0.6 and plot.depth_m > back + 7.5:
        plot.stand(building.garage(rng, wall), drive, back + 1.5)
    paving = Skin(3, Material.PAVING, (150, 142, 132))
    for k in range(int(back // PIECE_M)):
        plot.site.put(box((2.9, PIECE_M, 0.4), (0, 0, -0.17), paving), plot.front.at(drive, PIECE_M * (k + 0.5)))
    _boundary(plot, (drive - 1.8, drive + 1.8))
    if rng.uniform() < 0.5 and back > 5.6:
        plot.car(drive, back - 2.6, (-1 if rng.uniform() < 0.5 else 1) * np.pi / 2)
    for _ in range(int(rng.integers(1, 3))):
        plot.tree(
            -side * float(rng.uniform(-0.2, 0.9)) * (half - 1),
            float(rng.uniform(1.8, back - 1.9)),
            {**plot.theme.trees, "bush": 5},
        )
    if plot.depth_m > back + deep + 4:
        plot.tree(float(rng.uniform(-0.6, 0.6)) * half, plot.depth_m - 2)


def _hall(plot: Plot) -> None:
    rng = plot.rng
    back = float(rng.uniform(*plot.theme.setback_m))
    deep = plot.depth_m - back - 1
    plot.stand(building.hall(rng, plot.width_m - 4, deep, *plot.colors()), 0, back)
    kind = ("mesh", "concrete", "brick")[int(rng.integers(3))]
    gate = float(rng.uniform(-0.2, 0.2)) * plot.width_m
    plot.line(plot.stock.barriers[kind], (-plot.width_m / 2, 0.4), (gate - 4, 0.4))
    plot.line(plot.stock.barriers[kind], (gate + 4, 0.4), (plot.width_m / 2, 0.4))
    for x in rng.permutation(np.arange(-plot.width_m / 2 + 3, plot.width_m / 2 - 2, 4.2))[: int(rng.integers(1, 5))]:
        if back < 4.5 or abs(x - gate) < 3:
            continue
        if rng.uniform() < 0.4 and back > 6.5:
            plot.car(float(x), back - 3.4, np.pi / 2)
        else:
            plot.stand(one(rng, plot.stock.props[pick(rng, plot.theme.props)]), float(x), back - 2.2, np.pi)


def _yard(plot: Plot) -> None:
    """Stacked containers behind a fence."""
    rng, half = plot.rng, plot.width_m / 2
    for x in np.arange(-half + 4.5, half - 4, 7.0):
        for y in np.arange(4.0, plot.depth_m - 2.0, 3.4):
            if rng.uniform() < 0.7:
                plot.stand(_containers(rng), float(x), float(y))
    kind = "mesh" if rng.uniform() < 0.6 else "concrete"
    plot.line(plot.stock.barriers[kind], (-half, 0.4), (-3.5, 0.4))
    plot.line(plot.stock.barriers[kind], (3.5, 0.4), (half, 0.4))


def _containers(rng: np.random.Generator) -> Mesh:
    """Two high at most; class Other."""
    colors = ((150, 60, 44), (44, 92, 130), (60, 110, 76), (190, 150, 60), (140, 140, 140))
    skins = [Skin(8, Material.METAL, colors[int(k)]) for k in rng.integers(len(colors), size=int(rng.integers(1, 3)))]
    return concatenate(box((6.06, 2.44, 2.59), (0, 0, 1.3 + 2.6 * k), skin) for k, skin in enumerate(skins))


def _park(plot: Plot) -> None:
    rng, half = plot.rng, plot.width_m / 2
    for x in np.arange(-half + 2, half - 1.5, 5.5):
        for y in np.arange(2.5, plot.depth_m - 1.5, 5.5):
            if rng.uniform() < 0.75:
                plot.tree(float(x + rng.uniform(-1, 1)), float(y + rng.uniform(-1, 1)), {**plot.theme.trees, "bush": 2})
    plot.line(
        plot.stock.hedges if rng.uniform() < 0.5 else plot.stock.barriers["mesh"], (-half, 0.4), (0.3 * half, 0.4)
    )
    plot.stand(one(rng, plot.stock.park_lamps), 0.5 * half, 0.7)


def _lot(plot: Plot) -> None:
    """Parking lot: a row of cars nose to the street, one further back."""
    rng, half = plot.rng, plot.width_m / 2
    for y in np.arange(4.2, plot.depth_m - 3, 7.5)[: int(rng.integers(1, 3))]:
        for x in np.arange(-half + 1.6, half - 1.2, 2.7):
            if rng.uniform() < 0.5:
                plot.car(float(x), float(y), (-1 if rng.uniform() < 0.5 else 1) * np.pi / 2)
    kind = "guard" if rng.uniform() < 0.4 else "mesh"
    plot.line(plot.stock.barriers[kind], (-half, 0.4), (half - 5, 0.4))


def _field(plot: Plot) -> None:
    rng, half = plot.rng, plot.width_m / 2
    kind = pick(rng, {"rail": 3, "hedge": 2, "mesh": 1, "brick": 1})
    plot.line(plot.stock.hedges if kind == "hedge" else plot.stock.barriers[kind], (-half, 0.8), (half, 0.8))
    for _ in range(int(rng.integers(2, 6))):
        plot.tree(float(rng.uniform(-0.9, 0.9)) * half, float(rng.uniform(3, plot.depth_m - 2)))
    for _ in range(int(rng.integers(0, 4))):
        plot.stand(
            one(rng, plot.stock.props["bales"]),
            float(rng.uniform(-0.8, 0.8)) * half,
            float(rng.uniform(3, plot.depth_m - 2)),
            float(rng.uniform(0, 3)),
        )


def _farm(plot: Plot) -> None:
    rng = plot.rng
    back = float(rng.uniform(*plot.theme.setback_m))
    wide, deep = (
        min(plot.width_m - 4, float(rng.uniform(11, 18))),
        min(plot.depth_m - back - 1, float(rng.uniform(8, 12))),
    )
    plot.stand(building.barn(rng, wide, deep, *plot.colors()), 0, back)
    plot.line(plot.stock.barriers["rail"], (-plot.width_m / 2, 0.6), (-3, 0.6))
    plot.line(plot.stock.barriers["brick"], (3, 0.6), (plot.width_m / 2, 0.6))
    for x in (-0.4, 0.4):
        plot.tree(x * plot.width_m, float(rng.uniform(2, max(back - 2, 2.5))))
        plot.stand(one(rng, plot.stock.props["crates"]), 0.6 * x * plot.width_m, back - 1.5)


KINDS: dict[str, Callable[[Plot], None]] = {
    "tower": _tower, "row": _row, "house": _house, "hall": _hall, "yard": _yard, "park": _park, "lot": _lot,
    "field": _field, "farm": _farm,
}  # fmt: skip
