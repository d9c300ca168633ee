"""Plots of land behind the sidewalks; to add a kind, write a function of a `Plot` and enter it into `KINDS`."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from omniocc.seeding import choice, weighted_choice
from omniworld.assets import solid, tree, vehicle
from omniworld.assets.barrier import PIECE_M
from omniworld.assets.catalog import fitting_building, random_variant
from omniworld.mesh.label import GROUND, OTHER, SIDEWALK
from omniworld.mesh.material import Material
from omniworld.mesh.mesh import Mesh, concatenate
from omniworld.mesh.shape import Color, Number, Skin, box, lathe, panel
from omniworld.town.road import KERB_M
from omniworld.town.site import Pose2, Site
from omniworld.town.theme import Theme

_NEAR_M = 11.0  # from the sidewalk


@dataclass(frozen=True)
class Plot:
    """A rectangle whose front edge is behind the sidewalk.

    `front` is the middle of that edge; its x runs along the street and its y into the plot.
    """

    site: Site
    theme: Theme
    rng: np.random.Generator
    front: Pose2
    width_m: Number
    depth_m: Number

    def tree(self, x_m: Number, y_m: Number, kinds: dict[str, Number] | None = None) -> None:
        """Plant a tree or bush of the theme, one of few triangles far from the street."""
        kind = weighted_choice(self.rng, kinds or self.theme.trees) if y_m < _NEAR_M else "distant"
        color = choice(self.rng, tree.LEAF_COLORS)
        pose = self.front.at(x_m, y_m, float(self.rng.uniform(0, 2 * np.pi)))
        wide, high = (float(x) for x in self.rng.uniform(0.8, 1.25, 2))
        self.site.put(
            random_variant(self.rng, "tree", kind), pose, stretch=(wide, wide, high), paint={Material.LEAVES: color}
        )

    def line(self, kind: str, start: tuple[Number, Number], end: tuple[Number, Number]) -> None:
        """Put pieces of a fence, wall or hedge (`barrier.KINDS`) end to end."""
        piece = random_variant(self.rng, "barrier", kind)
        self._repeat(piece, start, end, {Material.LEAVES: tree.LEAF_COLORS[int(self.rng.integers(3))]})

    def front_line(self, kind: str, y_m: Number, gate: tuple[Number, Number]) -> None:
        """Put a fence, wall or hedge (`barrier.KINDS`) along the front, open between the two ends of the gate."""
        self.line(kind, (-self.width_m / 2, y_m), (gate[0], y_m))
        self.line(kind, (gate[1], y_m), (self.width_m / 2, y_m))

    def pave(self, start: tuple[Number, Number], end: tuple[Number, Number]) -> None:
        """Lay a path 3 m wide."""
        self._repeat(_PATH, start, end, None)

    def _repeat(
        self, piece: Mesh, start: tuple[Number, Number], end: tuple[Number, Number], paint: dict[Material, Color] | None
    ) -> None:
        """Put copies of a piece of `PIECE_M` end to end, stretched equally to fill the line."""
        run = np.subtract(end, start)
        length, yaw = float(np.hypot(*run)), float(np.arctan2(run[1], run[0]))
        count = max(1, round(length / PIECE_M))
        stretch = (length / count / PIECE_M, 1.0, 1.0)
        for k in range(count):
            x, y = np.asarray(start) + run * (k + 0.5) / count
            self.site.put(piece, self.front.at(float(x), float(y), yaw), stretch=stretch, paint=paint, follow=True)

    def place(self, mesh: Mesh, x_m: Number, y_m: Number, yaw_rad: Number = 0.0) -> None:
        """Put a mesh on the plot."""
        self.site.put(mesh, self.front.at(x_m, y_m, yaw_rad))

    def car(self, x_m: Number, y_m: Number, yaw_rad: Number) -> None:
        """Park a car."""
        color = choice(self.rng, vehicle.PAINTS)
        mesh = random_variant(self.rng, "vehicle", weighted_choice(self.rng, vehicle.PARKED))
        self.site.put(mesh, self.front.at(x_m, y_m, yaw_rad), paint={Material.CAR_PAINT: color})

    def building(self, kind: str, width_m: Number, depth_m: Number, x_m: Number, y_m: Number) -> None:
        """Put up a building of about this size, its front at y, in colours of the theme."""
        mesh, (wide, deep) = fitting_building(self.rng, kind, (width_m, depth_m))
        walls, roofs = self.theme.wall_colors, self.theme.roof_colors
        wall, roof = choice(self.rng, walls), choice(self.rng, roofs)
        paint = {Material.FACADE: wall, Material.PLASTER: wall, Material.ROOF: roof}
        stretch = (wide, deep, float(self.rng.uniform(0.88, 1.22)))
        self.site.put(mesh, self.front.at(x_m, y_m), stretch=stretch, paint=paint)


def _tower(plot: Plot) -> None:
    back = float(plot.rng.uniform(*plot.theme.setback_m))
    deep = min(plot.depth_m - back - 0.6, float(plot.rng.uniform(11, 17)))
    plot.building("tower", plot.width_m - 0.8, deep, 0, back)
    if back > 3.5:
        for x in np.arange(-plot.width_m / 2 + 2, plot.width_m / 2 - 1, 6):
            plot.tree(float(x), 1.2, {"bush": 3, "young": 1})


def _row(plot: Plot) -> None:
    back = float(plot.rng.uniform(plot.theme.setback_m[0], 0.6 * plot.theme.setback_m[1]))
    passage = 2.2 if back < 1.5 and plot.rng.uniform() < 0.4 else 0.0
    count = max(1, round((plot.width_m - passage) / 8))
    wide = (plot.width_m - passage - 0.6) / count
    if passage:
        plot.line("brick", (0.5 * plot.width_m - passage, back + 0.6), (0.5 * plot.width_m, back + 0.6))
    deep = min(plot.depth_m - back - 0.5, float(plot.rng.uniform(9, 12)))
    for k in range(count):
        plot.building("row", wide, deep, (k + 0.5 - count / 2) * wide - 0.5 * passage, back)
    if back > 2.5:
        kind = choice(plot.rng, ("brick", "picket", "mesh"))
        plot.front_line(kind, 0.3, (-0.12 * plot.width_m, 0.12 * plot.width_m))


def _boundary(plot: Plot, gate: tuple[Number, Number]) -> None:
    """Put a fence, wall or hedge along the front (open at the gate) and one side."""
    kind = weighted_choice(plot.rng, {"hedge": 3, "picket": 2, "brick": 1.5, "mesh": 1, "none": 2})
    if kind != "none":
        plot.front_line(kind, 0.5, gate)
    side, x = "hedge" if plot.rng.uniform() < 0.4 else "board", plot.width_m / 2 - 0.1
    plot.line(side, (x, 3.0), (x, plot.depth_m - 0.5))


_DRIVEWAY = panel((2.06, 2.9, 0.4), (0, 0, -0.17), Skin(GROUND, Material.PAVING, (150, 142, 132)), "frblt")


def _house(plot: Plot) -> None:
    rng, half = plot.rng, plot.width_m / 2
    back = float(rng.uniform(*plot.theme.setback_m))
    wide = min(float(rng.uniform(8, 12.5)), plot.width_m - 5.5)
    deep = min(float(rng.uniform(7.5, 10.5)), plot.depth_m - back - 1)
    side = -1.0 if rng.uniform() < 0.5 else 1.0
    driveway = side * (half - 2.2)
    plot.building("house", wide, deep, -side * (half - wide / 2 - 0.9), back)
    if half * 2 - wide > 5.2 and rng.uniform() < 0.6 and plot.depth_m > back + 7.5:
        plot.building("garage", 3.2, 5.5, driveway, back + 1.5)
    for k in range(int(back // 2)):
        plot.site.put(_DRIVEWAY, plot.front.at(driveway, 2.0 * k + 1.0, np.pi / 2), follow=True)
    _boundary(plot, (driveway - 1.8, driveway + 1.8))
    if rng.uniform() < 0.5 and back > 5.6:
        plot.car(driveway, back - 2.6, (-1 if rng.uniform() < 0.5 else 1) * np.pi / 2)
    for _ in range(int(rng.integers(1, 3))):
        x, y = -side * float(rng.uniform(-0.2, 0.9)) * (half - 1), float(rng.uniform(1.8, max(back - 1.9, 2.0)))
        plot.tree(x, y, {**plot.theme.trees, "bush": 5})
    if plot.depth_m > back + deep + 4:
        plot.tree(float(rng.uniform(-0.6, 0.6)) * half, plot.depth_m - 2)


def _hall(plot: Plot) -> None:
    rng = plot.rng
    back = float(rng.uniform(*plot.theme.setback_m))
    deep = plot.depth_m - back - 1
    plot.building("hall", plot.width_m - 4, deep, 0, back)
    kind = choice(rng, ("mesh", "concrete", "brick"))
    gate = float(rng.uniform(-0.2, 0.2)) * plot.width_m
    plot.front_line(kind, 0.4, (gate - 4, gate + 4))
    for x in rng.permutation(np.arange(-plot.width_m / 2 + 3, plot.width_m / 2 - 2, 4.2))[: int(rng.integers(1, 5))]:
        if back < 4.5 or abs(x - gate) < 3:
            continue
        if rng.uniform() < 0.4 and back > 6.5:
            plot.car(float(x), back - 3.4, np.pi / 2)
        else:
            plot.place(random_variant(rng, "prop", weighted_choice(rng, plot.theme.props)), float(x), back - 2.2, np.pi)


_CONTAINER = box((6.06, 2.44, 2.59), (0, 0, 1.3), Skin(OTHER, Material.METAL, (140, 140, 140)))
_CONTAINERS: tuple[Color, ...] = ((150, 60, 44), (44, 92, 130), (60, 110, 76), (190, 150, 60), (140, 140, 140))


def _yard(plot: Plot) -> None:
    """Stack containers behind a fence."""
    rng, half = plot.rng, plot.width_m / 2
    for x in np.arange(-half + 4.5, half - 4, 7.0):
        for y in np.arange(4.0, plot.depth_m - 2.0, 3.4):
            if rng.uniform() < 0.7:
                for k in range(int(rng.integers(1, 3))):
                    color = choice(rng, _CONTAINERS)
                    pose = plot.front.at(float(x), float(y))
                    plot.site.put(_CONTAINER, pose, lift_m=KERB_M + 2.6 * k, paint={Material.METAL: color})
    plot.front_line("mesh" if rng.uniform() < 0.6 else "concrete", 0.4, (-3.5, 3.5))


def _park(plot: Plot) -> None:
    rng, half = plot.rng, plot.width_m / 2
    for x in np.arange(-half + 2, half - 1.5, 6.5):
        for y in np.arange(2.5, plot.depth_m - 1.5, 6.5):
            if rng.uniform() < 0.75:
                plot.tree(float(x + rng.uniform(-1, 1)), float(y + rng.uniform(-1, 1)), {**plot.theme.trees, "bush": 2})
    plot.line("hedge" if rng.uniform() < 0.5 else "mesh", (-half, 0.4), (0.3 * half, 0.4))
    plot.place(random_variant(rng, "pole", "park"), 0.5 * half, 0.7)


def _lot(plot: Plot) -> None:
    """Fill a parking lot: a row of cars nose to the street, sometimes a second one behind it."""
    rng, half = plot.rng, plot.width_m / 2
    for y in np.arange(4.2, plot.depth_m - 3, 7.5)[: int(rng.integers(1, 3))]:
        for x in np.arange(-half + 1.6, half - 1.2, 2.7):
            if rng.uniform() < 0.3:
                plot.car(float(x), float(y), (-1 if rng.uniform() < 0.5 else 1) * np.pi / 2)
    plot.line("guard" if rng.uniform() < 0.4 else "mesh", (-half, 0.4), (half - 5, 0.4))


def _field(plot: Plot) -> None:
    rng, half = plot.rng, plot.width_m / 2
    kind = weighted_choice(rng, {"rail": 3, "hedge": 2, "mesh": 1, "brick": 1})
    plot.line(kind, (-half, 0.8), (half, 0.8))
    for _ in range(int(rng.integers(2, 6))):
        plot.tree(float(rng.uniform(-0.9, 0.9)) * half, float(rng.uniform(3, plot.depth_m - 2)))
    for _ in range(int(rng.integers(0, 4))):
        mesh, x = random_variant(rng, "prop", "bales"), float(rng.uniform(-0.8, 0.8)) * half
        plot.place(mesh, x, float(rng.uniform(3, plot.depth_m - 2)), float(rng.uniform(0, 3)))


def _farm(plot: Plot) -> None:
    rng = plot.rng
    back = float(rng.uniform(*plot.theme.setback_m))
    wide = min(plot.width_m - 4, float(rng.uniform(11, 18)))
    deep = min(plot.depth_m - back - 1, float(rng.uniform(8, 12)))
    plot.building("barn", wide, deep, 0, back)
    plot.line("rail", (-plot.width_m / 2, 0.6), (-3, 0.6))
    plot.line("brick", (3, 0.6), (plot.width_m / 2, 0.6))
    for x in (-0.4, 0.4):
        plot.tree(x * plot.width_m, float(rng.uniform(2, max(back - 2, 2.5))))
        plot.place(random_variant(rng, "prop", "crates"), 0.6 * x * plot.width_m, back - 1.5)


def _college(plot: Plot) -> None:
    rng, half = plot.rng, plot.width_m / 2
    back = float(rng.uniform(*plot.theme.setback_m))
    plot.building("college", plot.width_m - 3, min(plot.depth_m - back - 1, float(rng.uniform(12, 16))), 0, back)
    plot.pave((0, 0), (0, back - 3.5))
    for x in np.arange(-half + 2, half - 1, 6.0):
        if abs(x) > 5:
            plot.tree(float(x), float(rng.uniform(1.5, max(back - 3, 2.0))))
    plot.front_line("hedge", 0.4, (-5, 5))


def _green(plot: Plot) -> None:
    """Lay a lawn with a path across, benches and lamps beside it, and old trees."""
    rng, half = plot.rng, plot.width_m / 2
    start, end = np.array([-0.7 * half, 0.0]), np.array([0.7 * half, plot.depth_m - 1])
    length = float(np.hypot(*(end - start)))
    run = (end - start) / length
    yaw = float(np.arctan2(run[1], run[0]))
    plot.pave((float(start[0]), float(start[1])), (float(end[0]), float(end[1])))
    for number, s in enumerate(np.arange(4.0, length - 2, 7.0)):
        x, y = start + s * run + np.array([-run[1], run[0]]) * 2.2
        mesh = random_variant(rng, "prop", "bench") if number % 2 else random_variant(rng, "pole", "park")
        plot.place(mesh, float(x), float(y), yaw + np.pi)
    for _ in range(int(plot.width_m * plot.depth_m / 110)):
        x, y = float(rng.uniform(-half + 1.5, half - 1.5)), float(rng.uniform(1.5, plot.depth_m - 1))
        if abs(run[0] * (y - start[1]) - run[1] * (x - start[0])) > 3.5:
            plot.tree(x, y)


def _churchyard(plot: Plot) -> None:
    rng, half = plot.rng, plot.width_m / 2
    plot.building("church", min(plot.width_m - 1.5, 16.0), min(plot.depth_m - 4.5, 19.0), 0, 3.5)
    plot.front_line("brick", 0.4, (-2, 2))
    for x in (-half + 1.2, half - 1.2):
        plot.tree(x, float(rng.uniform(1.6, 3)), {"young": 2, "bush": 1})


def _square(plot: Plot) -> None:
    """Pave a square with stalls and a fountain."""
    rng, half = plot.rng, plot.width_m / 2
    across, down = int(plot.width_m // 3), int((plot.depth_m - 0.2) // 3)
    for x in (np.arange(across) + 0.5 - across / 2) * 3:
        for y in (np.arange(down) + 0.5) * 3:
            plot.site.put(_TILE, plot.front.at(float(x), float(y)))
    plot.place(_FOUNTAIN, 0.0, 0.5 * plot.depth_m)
    for x in np.arange(-half + 2.5, half - 2, 5.0):
        for y in (3.0, plot.depth_m - 3.0):
            if rng.uniform() < 0.6:
                kind = weighted_choice(rng, {"kiosk": 3, "bench": 2, "planter": 2})
                plot.place(random_variant(rng, "prop", kind), float(x), float(y), np.pi if y < 4 else 0.0)
    plot.line("brick", (-half, plot.depth_m - 0.4), (half, plot.depth_m - 0.4))


_PATH = panel((PIECE_M + 0.1, 3.0, 0.4), (0, 0, -0.17), Skin(SIDEWALK, Material.PAVING, (172, 160, 140)), "frblt")
_TILE = panel((3.06, 3.06, 0.6), (0, 0, -0.26), Skin(SIDEWALK, Material.PAVING, (160, 150, 136)), "frblt")
_STONE = Skin(OTHER, Material.CONCRETE, (168, 164, 154))
_FOUNTAIN = concatenate(
    [
        lathe([2.2, 2.3, 2.0, 1.9], [-0.3, 0.6, 0.6, 0.35], 14, _STONE),
        lathe([1.95, 0.0], [0.4, 0.41], 14, Skin(OTHER, Material.GLASS, (70, 100, 110))),
        lathe([0.3, 0.2, 0.8, 0.0], [0.2, 1.5, 1.8, 1.7], 10, _STONE),
    ]
)


def _solids(plot: Plot) -> None:
    """Scatter plain solids on the plot and in the air above it, most of them near the street."""
    rng, half = plot.rng, plot.width_m / 2
    for _ in range(int(plot.width_m * plot.depth_m / 12)):
        x, y = float(rng.uniform(-half, half)), float(plot.depth_m * rng.uniform() ** 2)
        kind = choice(rng, tuple(solid.KINDS))
        mesh = random_variant(rng, "solid", kind)
        lift = float(rng.uniform(0, 5)) if kind in ("block", "ball") and rng.uniform() < 0.4 else 0.0
        wide, high = np.exp(rng.uniform(-0.5, 0.7, 2)).tolist()
        paint = {Material(int(mesh.material[0])): solid.random_color(rng)}
        pose = plot.front.at(x, y, float(rng.uniform(0, 2 * np.pi)))
        plot.site.put(mesh, pose, stretch=(wide, wide, high), lift_m=KERB_M + lift, paint=paint)


KINDS: dict[str, Callable[[Plot], None]] = {
    "tower": _tower,
    "row": _row,
    "house": _house,
    "hall": _hall,
    "yard": _yard,
    "park": _park,
    "lot": _lot,
    "field": _field,
    "farm": _farm,
    "college": _college,
    "green": _green,
    "church": _churchyard,
    "square": _square,
    "solids": _solids,
}
