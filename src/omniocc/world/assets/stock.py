"""The prototypes that places are furnished with: some variants of every kind, made once in a process."""

from collections.abc import Mapping
from functools import lru_cache

import numpy as np

from omniocc.world import seeding
from omniocc.world.assets import barrier, building, person, pole, prop, tree, vehicle
from omniocc.world.assets.mesh import Mesh
from omniocc.world.assets.shape import Number

_MAKERS = {
    "tree": tree.KINDS,
    "barrier": barrier.KINDS,
    "prop": {kind: made.make for kind, made in prop.KINDS.items()},
    "pole": pole.KINDS,
    "vehicle": vehicle.KINDS,
    "building": building.KINDS,
}
_VARIANTS = {"tree": 8, "barrier": 4, "prop": 5, "pole": 8, "vehicle": 6, "building": 12}


_PEOPLE = 16


@lru_cache(maxsize=256)
def shelf(group: str, kind: str) -> tuple[Mesh, ...]:
    """All variants of a kind (see `KINDS` of the module of that name); the same in every process."""
    make, rng = _MAKERS[group][kind], seeding.generator(group, 0, kind)
    return tuple(make(rng) for _ in range(_VARIANTS[group]))


@lru_cache(maxsize=1)
def people() -> tuple[tuple[list[Mesh], tuple[float, float, float]], ...]:
    """Walkers, each in all poses of a stride (see `person.walking`), and their sizes."""
    rng = seeding.generator("person", 0, "walking")
    drawn = [person.walking(rng) for _ in range(_PEOPLE)]
    return tuple((poses, person.size_m(poses)) for poses in drawn)


def pick(rng: np.random.Generator, weights: Mapping[str, Number]) -> str:
    """One key, with probability proportional to its weight."""
    names = list(weights)
    share = np.cumsum([weights[name] for name in names])
    return names[int(np.searchsorted(share, rng.uniform() * share[-1], side="right"))]


def one(rng: np.random.Generator, group: str, kind: str) -> Mesh:
    """One of the variants."""
    variants = shelf(group, kind)
    return variants[int(rng.integers(len(variants)))]


def fitting(rng: np.random.Generator, kind: str, size_m: tuple[Number, Number]) -> tuple[Mesh, tuple[float, float]]:
    """One of the three buildings that need the least stretching to stand on (width, depth), and the two stretches."""
    stretch = np.log(np.asarray(size_m) / _footprints(kind))
    index = np.argsort(np.abs(stretch).sum(1))[int(rng.integers(3))]
    wide, deep = np.exp(stretch[index])
    return shelf("building", kind)[index], (float(wide), float(deep))


@lru_cache(maxsize=32)
def _footprints(kind: str) -> np.ndarray:
    return np.array([building.footprint_m(mesh) for mesh in shelf("building", kind)])
