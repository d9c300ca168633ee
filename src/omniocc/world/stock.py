"""The prototypes a place is furnished with: a few variants of every kind."""

from dataclasses import dataclass

import numpy as np

from omniocc.world import barrier, pole, prop, tree, vehicle
from omniocc.world.mesh import Mesh
from omniocc.world.theme import Theme

_PARKED = ("sedan", "hatchback", "suv", "sedan", "hatchback", "suv", "van")


@dataclass(frozen=True)
class Stock:
    """Variants by kind; see the modules of the same names."""

    trees: dict[str, list[Mesh]]
    hedges: list[Mesh]
    barriers: dict[str, list[Mesh]]
    props: dict[str, list[Mesh]]
    lamps: list[Mesh]
    park_lamps: list[Mesh]
    signs: list[Mesh]
    lights: list[Mesh]
    cars: list[Mesh]


def draw(theme: Theme, rng: np.random.Generator) -> Stock:
    """The stock of one place."""
    wooden = theme.name == "countryside"
    return Stock(
        trees={kind: [make(rng) for _ in range(4)] for kind, make in tree.KINDS.items()},
        hedges=[tree.hedge(rng) for _ in range(4)],
        barriers={kind: [make(rng) for _ in range(3)] for kind, make in barrier.KINDS.items()},
        props={kind: [prop.KINDS[kind].make(rng) for _ in range(3)] for kind in theme.props},
        lamps=[pole.utility_pole(rng) if wooden and k else pole.street_lamp(rng) for k in range(2)],
        park_lamps=[pole.park_lamp(rng) for _ in range(2)],
        signs=[pole.sign(rng) for _ in range(8)],
        lights=[pole.traffic_light(rng) for _ in range(4)],
        cars=[vehicle.KINDS[kind](rng) for kind in _PARKED],
    )


def pick(rng: np.random.Generator, weights: dict[str, float]) -> str:
    """One key, with probability proportional to its weight."""
    names = list(weights)
    share = np.cumsum([weights[name] for name in names])
    return names[int(np.searchsorted(share, rng.uniform() * share[-1], side="right"))]


def one(rng: np.random.Generator, variants: list) -> Mesh:
    """One of the variants."""
    return variants[int(rng.integers(len(variants)))]
