"""Prototypes of the objects in towns: some variants of every kind, built once per process."""

from functools import lru_cache

import numpy as np

from omniocc import seeding
from omniworld.assets import barrier, building, person, pole, prop, solid, tree, vehicle
from omniworld.mesh.mesh import Mesh
from omniworld.mesh.shape import Number

_GROUPS = {  # builders by kind, and how many variants of each kind there are
    "tree": (tree.KINDS, 8),
    "barrier": (barrier.KINDS, 4),
    "pole": (pole.KINDS, 8),
    "vehicle": (vehicle.KINDS, 6),
    "building": (building.KINDS, 12),
    "prop": ({kind: made.make for kind, made in prop.KINDS.items()}, 5),
    "solid": (solid.KINDS, 16),
}
_PEOPLE = 16


@lru_cache(maxsize=256)
def variants(group: str, kind: str) -> tuple[Mesh, ...]:
    """Return all variants of a kind (see `KINDS` of the group's module); equal in every process."""
    (builders, count), rng = _GROUPS[group], seeding.generator(group, 0, kind)
    return tuple(builders[kind](rng) for _ in range(count))


@lru_cache(maxsize=1)
def people() -> tuple[tuple[list[Mesh], tuple[float, float, float]], ...]:
    """Return walkers, each in all poses of a stride (see `person.walking`), and their sizes."""
    rng = seeding.generator("person", 0, "walking")
    drawn = [person.walking(rng) for _ in range(_PEOPLE)]
    return tuple((poses, person.size_m(poses)) for poses in drawn)


def random_variant(rng: np.random.Generator, group: str, kind: str) -> Mesh:
    """Return one of the variants of a kind."""
    return seeding.choice(rng, variants(group, kind))


def fitting_building(
    rng: np.random.Generator, kind: str, size_m: tuple[Number, Number]
) -> tuple[Mesh, tuple[float, float]]:
    """Return a building that needs little stretching to fill (width, depth), and its two stretch factors.

    It is drawn from the three that need the least.
    """
    stretch = np.log(np.asarray(size_m) / _footprints(kind))
    index = np.argsort(np.abs(stretch).sum(1))[int(rng.integers(3))]
    wide, deep = np.exp(stretch[index])
    return variants("building", kind)[index], (float(wide), float(deep))


@lru_cache(maxsize=32)
def _footprints(kind: str) -> np.ndarray:
    return np.array([building.footprint_m(mesh) for mesh in variants("building", kind)])
