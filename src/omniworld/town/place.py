"""A place: the static mesh of a virtual town, with the streets and signals that traffic needs."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from omniocc import seeding
from omniocc.seeding import choice
from omniworld.assets.barrier import PIECE_M
from omniworld.assets.catalog import random_variant
from omniworld.assets.solid import random_color, random_material
from omniworld.assets.tree import LEAF_COLORS
from omniworld.mesh.label import BUILDING, GROUND, OTHER, SIDEWALK, VEGETATION, WALL
from omniworld.mesh.material import Material
from omniworld.mesh.mesh import Mesh, concatenate
from omniworld.mesh.shape import Skin, blob, box, lathe, panel, sheet
from omniworld.town import marking, network, road, street, terrain, themes
from omniworld.town.line import arc_lengths
from omniworld.town.network import Network, center_line, degrees
from omniworld.town.road import CROWN_M
from omniworld.town.site import Plan, Pose2, Signal, Site
from omniworld.town.terrain import Terrain
from omniworld.town.theme import Theme

# names of themes
THEMES: tuple[str, ...] = tuple(theme.name for theme in themes.TOWNS)
"""Places that look like places."""
ABSTRACT: tuple[str, ...] = tuple(name for name in themes.ALL if name not in THEMES)
"""Places that look like nothing, for networks that are to learn no habits."""
_CROSSING_FRACTION = 0.5
_PLAN_RADIUS_M = 300.0
_SPAN_M, _CLEARANCE_M, _HALF_WIDTH_M = 11.0, 5.4, 4.2  # of the railway's deck
_CONCRETE = Skin(OTHER, Material.CONCRETE, (150, 148, 142))
_PILLAR = box((1.3, 1.3, 1.0), (0, 0, 0.5), _CONCRETE)
_HALL_BELOW_M = 2.0  # walls reach into the ground, which is not level
_HALL_M = 600.0  # side of the ceiling
_TREES, _HOUSES, _WOODS = 50, 50, 60  # tries in the backdrop


@dataclass(frozen=True)
class Place:
    """A town of about 300 x 300 m around the world's origin.

    Attributes:
        theme: recipe of the town.
        mesh: all static faces, world frame.
        terrain: height of the land; kerbs and streets are within 0.15 m of it.
        network: streets and blocks.
        paved: which blocks (rings of the network) have a sidewalk.
        crossings: ends of streets with a zebra crossing: (index of the street, whether at its end, not its start).
        signals: traffic lights; `Traffic` switches their lamps.
    """

    theme: Theme
    mesh: Mesh
    terrain: Terrain
    network: Network
    paved: tuple[bool, ...]
    crossings: frozenset[tuple[int, bool]]
    signals: tuple[Signal, ...]


def build(theme: str, seed: int) -> Place:
    """Build the place (theme, seed), every time the same bytes; raise ValueError if the theme does not exist."""
    if theme not in themes.ALL:
        raise ValueError(f"unknown theme {theme!r}; possible: {', '.join(themes.ALL)}")
    recipe = themes.ALL[theme]
    land = terrain.draw(seeding.generator(theme, seed, "terrain"), recipe.slope, recipe.horizon_m)
    town = network.draw(recipe, seeding.generator(theme, seed, "network"))
    rng = seeding.generator(theme, seed, "sidewalks")
    paved = tuple(bool(x) for x in rng.uniform(size=len(town.rings)) < recipe.paved_fraction)
    arms = [(index, end) for index in range(len(town.edges)) for end in (False, True)]
    crossings = frozenset(
        arm for arm, x in zip(arms, rng.uniform(size=len(arms)), strict=True) if x < _CROSSING_FRACTION
    )
    site = Site(land, Plan(_PLAN_RADIUS_M))
    street.reserve(recipe, town, site.plan)
    rng = seeding.generator(theme, seed, "middle")
    extras = [islands(recipe, town, site, rng), medians(recipe, town, land, site, rng)]
    if recipe.railway:
        extras.append(railway(town, site))
    rng = seeding.generator(theme, seed, "hall")
    if rng.uniform() < recipe.hall_fraction:
        extras.append(hall(recipe, town, land, rng))
    for index, (ring, has_sidewalk) in enumerate(zip(town.rings, paved, strict=True)):
        street.furnish(
            recipe, town, ring, has_sidewalk, crossings, site, rng=seeding.generator(theme, seed, f"block {index}")
        )
    backdrop(recipe, site, seeding.generator(theme, seed, "backdrop"))
    surfaces = road.build(recipe, land, town, paved, seeding.generator(theme, seed, "surfaces"))
    mesh = concatenate([surfaces, marking.build(recipe, land, town, crossings), *extras, site.mesh()])
    return Place(recipe, mesh, land, town, paved, crossings, signals=tuple(site.signals))


def islands(theme: Theme, network: Network, site: Site, rng: np.random.Generator) -> Mesh:
    """Build a lawn inside a round kerb, with shrubs, in the middle of every junction of four streets."""
    parts = []
    for (x, y), meeting in zip(network.junctions_m.tolist(), degrees(network), strict=True):
        if meeting < 4 or theme.island_m == 0:
            continue
        ground = float(site.terrain.height(x, y)) + CROWN_M
        radius = theme.island_m
        kerb = lathe(
            [radius, radius, radius - 0.9],
            [ground - 1.0, ground + 0.16, ground + 0.2],
            20,
            Skin(SIDEWALK, Material.CONCRETE, (176, 172, 164)),
            (x, y),
        )
        lawn = lathe(
            [radius - 0.9, 0.5 * radius, 0],
            [ground + 0.2, ground + 0.55, ground + 0.7],
            20,
            Skin(GROUND, Material.GRASS, (88, 120, 60)),
            (x, y),
        )
        parts += [kerb, lawn]
        for k in range(int(rng.integers(3, 7))):
            pose = Pose2(x, y, k * 1.1).at(float(rng.uniform(0.3, 0.55)) * radius, 0.0, float(rng.uniform(0, 3)))
            kind = "bush" if k else choice(rng, ("conifer", "round", "bush"))
            color = choice(rng, LEAF_COLORS)
            site.put(random_variant(rng, "tree", kind), pose, lift_m=CROWN_M + 0.4, paint={Material.LEAVES: color})
    return concatenate(parts)


def medians(theme: Theme, network: Network, terrain: Terrain, site: Site, rng: np.random.Generator) -> Mesh:
    """Build a low kerb with a guard rail along the middle of the streets, open near junctions."""
    if theme.median_m == 0:
        return concatenate([])
    parts, rail = [], random_variant(rng, "barrier", "median")
    for side in (side for ring in network.rings for side in ring.sides if side.forward):
        along = np.arange(side.along_m[0] + 7.0, side.along_m[-1] - 7.0, PIECE_M)
        center, normal = center_line(network.junctions_m, network.edges[side.edge], along)
        yaw = np.arctan2(-normal[:, 0], normal[:, 1])
        for (x, y), angle in zip(center.tolist(), yaw.tolist(), strict=True):
            site.put(rail, Pose2(x, y, angle), lift_m=CROWN_M + 0.1, follow=True)
        half = 0.5 * theme.median_m - 0.25
        across, height = np.array([half, half - 0.05, -half + 0.05, -half]), np.array([-0.1, 0.14, 0.14, -0.1])
        xy = center[:, None] + across[:, None] * normal[:, None]
        over = (terrain.height(*center.T) + CROWN_M)[:, None] + height
        net = np.concatenate([xy, over[..., None]], -1)
        uv = np.stack(np.meshgrid(across, along), -1)
        parts.append(sheet(net[::-1], uv[::-1], Skin(WALL, Material.CONCRETE, (158, 156, 150))))
    return concatenate(parts)


def railway(network: Network, site: Site) -> Mesh:
    """Build a deck on pillars across the town, over the middles of parallel streets; the land under it is taken."""
    count = round(len(network.junctions_m) ** 0.5)
    grid = network.junctions_m.reshape(count, count, 2)
    first, last = grid[0, 1:3].mean(0), grid[-1, 1:3].mean(0)
    ahead = (last - first) / np.linalg.norm(last - first)
    steps = np.arange(-60.0, np.linalg.norm(last - first) + 60.0, _SPAN_M)
    points = first + steps[:, None] * ahead
    low = site.terrain.height(*points.T)
    level = np.convolve(np.pad(low, 3, "edge"), np.hanning(9)[1:-1] / np.hanning(9).sum(), "valid")
    # the deck follows the smoothed land, and keeps its clearance over the land itself
    top = np.maximum(level, low) + _CLEARANCE_M
    yaw = float(np.arctan2(ahead[1], ahead[0]))
    for (x, y), ground, deck in zip(points, low, top, strict=True):
        for side in (-2.6, 2.6):
            pose = Pose2(float(x), float(y), yaw).at(0.0, side)
            if site.plan.claim(pose, (1.6, 1.6)):
                site.put(_PILLAR, pose, stretch=(1.0, 1.0, float(deck - ground + 1.0)), lift_m=-0.5)
    left = np.array([-ahead[1], ahead[0]])
    fine = np.arange(steps[0], steps[-1], 0.3)
    under = first + fine[:, None] * ahead
    site.plan.block(under[:, None] + np.arange(-_HALF_WIDTH_M - 0.5, _HALF_WIDTH_M + 0.6, 0.3)[:, None] * left)
    return _deck(points, top, left)


def _deck(points: np.ndarray, top: np.ndarray, left: np.ndarray) -> Mesh:
    """Build beam, slab and parapets by extruding one profile along the line."""
    w = _HALF_WIDTH_M
    outline = np.array(
        [
            (-w, 1.9),
            (-w, 0.9),
            (-2.9, 0.0),
            (2.9, 0.0),
            (w, 0.9),
            (w, 1.9),
            (w - 0.25, 1.9),
            (w - 0.25, 1.0),
            (-w + 0.25, 1.0),
            (-w + 0.25, 1.9),
            (-w, 1.9),
        ]
    )
    xy = points[:, None] + outline[:, :1] * left
    net = np.concatenate([xy, np.broadcast_to((top[:, None] + outline[:, 1])[..., None], (*xy.shape[:2], 1))], -1)
    uv = np.stack(np.meshgrid(arc_lengths(outline), _SPAN_M * np.arange(len(points))), -1)
    return sheet(net[::-1], uv[::-1], _CONCRETE)


def hall(theme: Theme, network: Network, terrain: Terrain, rng: np.random.Generator) -> Mesh:
    """Build the walls of a hall, some metres behind the kerbs, and one level ceiling, clear of the heads of walkers."""
    ends = [ring.kerb_m for ring in network.rings]
    highest_m = float(terrain.height(*np.concatenate(ends).T).max())
    ceiling_m = highest_m + float(rng.uniform(3.0, 7.0))
    back_m = theme.sidewalk_m + float(rng.uniform(0.2, 2.5))
    parts = [panel((_HALL_M, _HALL_M, 0.2), (0, 0, ceiling_m + 0.1), _skin(rng), "d")]
    for ring in network.rings:
        foot = ring.offset(back_m)
        closed = np.concatenate([foot, foot[:1]])
        height_m = np.array([-_HALL_BELOW_M, ceiling_m])
        low, high = (np.column_stack([closed, np.full(len(closed), z)]) for z in height_m)
        parts.append(sheet(np.stack([low, high]), np.stack(np.meshgrid(arc_lengths(low), height_m), -1), _skin(rng)))
    return concatenate(parts)


def _skin(rng: np.random.Generator) -> Skin:
    return Skin(BUILDING, random_material(rng), random_color(rng))


def backdrop(theme: Theme, site: Site, rng: np.random.Generator) -> None:
    """Scatter trees, plain buildings and, further out, woods between the town and 420 m from its middle."""
    edge = 1.5 * theme.spacing_m + 38.0
    for pose in _scattered(rng, _TREES, edge, 300.0):
        if site.plan.claim(pose, (4.0, 4.0)):
            color = choice(rng, LEAF_COLORS)
            site.put(random_variant(rng, "tree", "distant"), pose, paint={Material.LEAVES: color})
    block, woods = _distant_meshes()
    for pose in _scattered(rng, _HOUSES, edge + 10.0, 330.0):
        if site.plan.claim(pose, (17.0, 14.0)):
            color = choice(rng, theme.wall_colors)
            high = theme.skyline_m / 8.0 * float(rng.uniform(0.6, 1.5))
            site.put(block, pose, stretch=(1.0, 1.0, high), paint={Material.FACADE: color})
    for pose in _scattered(rng, _WOODS, 320.0, 420.0):
        color = LEAF_COLORS[int(rng.integers(3))]
        site.put(choice(rng, woods), pose, paint={Material.LEAVES: color})


@lru_cache(maxsize=1)
def _distant_meshes() -> tuple[Mesh, list[Mesh]]:
    """Return a plain building 8 m high, and groups of trees."""
    rng = seeding.generator("backdrop", 0, "woods")
    walls, roof = Skin(BUILDING, Material.FACADE, (150, 150, 150)), Skin(BUILDING, Material.ROOF, (96, 84, 78))
    leaves = Skin(VEGETATION, Material.LEAVES, (70, 92, 52))
    woods = [blob(rng, (15, 11, 9), (0, 0, 1), leaves, 0.25, 8, rows=4) for _ in range(4)]
    return box((16, 13, 12), (0, 0, 2), walls, roof), woods


def _scattered(rng: np.random.Generator, count: int, least_m: float, most_m: float) -> list[Pose2]:
    angle, yaw = rng.uniform(0, 2 * np.pi, (2, count))
    distance = rng.uniform(least_m, most_m, count)
    return [Pose2(*row) for row in np.stack([distance * np.cos(angle), distance * np.sin(angle), yaw], 1).tolist()]
