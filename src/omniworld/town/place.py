"""A place: the static mesh of a virtual town, with the streets and signals that traffic needs."""

from dataclasses import dataclass

from omniocc import seeding
from omniworld.mesh.mesh import Mesh, concatenate
from omniworld.town import backdrop, hall, islands, marking, network, railway, road, street, terrain, themes
from omniworld.town.network import Network
from omniworld.town.site import Plan, Signal, Site
from omniworld.town.terrain import Terrain
from omniworld.town.theme import Theme

THEMES: tuple[str, ...] = tuple(theme.name for theme in themes.TOWNS)
"""Places that look like places."""
ABSTRACT: tuple[str, ...] = tuple(name for name in themes.ALL if name not in THEMES)
"""Places that look like nothing, for networks that are to learn no habits."""
_CROSSING_FRACTION = 0.5
_PLAN_RADIUS_M = 300.0


@dataclass(frozen=True)
class Place:
    """A town of about 300 x 300 m around the world's origin.

    Attributes:
        theme: its recipe.
        mesh: all static faces, world frame.
        terrain: height of the land; kerbs and streets are within 0.15 m of it.
        network: streets and blocks.
        paved: which blocks (rings of the network) have a sidewalk.
        crossings: (street, at its end) of the junction arms with a zebra crossing.
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
    """Build the place (theme, seed): the same bytes every time; raise ValueError if the theme does not exist."""
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
    extras = [islands.islands(recipe, town, site, rng), islands.medians(recipe, town, land, site, rng)]
    if recipe.railway:
        extras.append(railway.railway(town, site))
    rng = seeding.generator(theme, seed, "hall")
    if rng.uniform() < recipe.hall_fraction:
        extras.append(hall.hall(recipe, town, land, rng))
    for index, (ring, has_sidewalk) in enumerate(zip(town.rings, paved, strict=True)):
        street.furnish(
            recipe, town, ring, has_sidewalk, crossings, site, seeding.generator(theme, seed, f"block {index}")
        )
    backdrop.fill(recipe, site, seeding.generator(theme, seed, "backdrop"))
    surfaces = road.build(recipe, land, town, paved, seeding.generator(theme, seed, "surfaces"))
    mesh = concatenate([surfaces, marking.build(recipe, land, town, crossings), *extras, site.mesh()])
    return Place(recipe, mesh, land, town, paved, crossings, tuple(site.signals))
