"""The open country around the town, so that streets end in a landscape instead of sky."""

from functools import lru_cache

import numpy as np

from omniocc import seeding
from omniocc.seeding import choice
from omniworld.assets import tree
from omniworld.assets.catalog import random_variant
from omniworld.mesh.label import BUILDING, VEGETATION
from omniworld.mesh.material import Material
from omniworld.mesh.mesh import Mesh
from omniworld.mesh.shape import Skin, blob, box
from omniworld.town.site import Pose2, Site
from omniworld.town.theme import Theme

_TREES, _HOUSES, _WOODS = 50, 50, 60


def fill(theme: Theme, site: Site, rng: np.random.Generator) -> None:
    """Scatter trees, plain buildings and, further out, woods between the town and 420 m from its middle."""
    edge = 1.5 * theme.spacing_m + 38.0
    for pose in _scattered(rng, _TREES, edge, 300.0):
        if site.plan.claim(pose, (4.0, 4.0)):
            color = choice(rng, tree.LEAF_COLORS)
            site.put(random_variant(rng, "tree", "distant"), pose, paint={Material.LEAVES: color})
    block, woods = _distant_meshes()
    for pose in _scattered(rng, _HOUSES, edge + 10.0, 330.0):
        if site.plan.claim(pose, (17.0, 14.0)):
            color = choice(rng, theme.wall_colors)
            high = theme.skyline_m / 8.0 * float(rng.uniform(0.6, 1.5))
            site.put(block, pose, stretch=(1.0, 1.0, high), paint={Material.FACADE: color})
    for pose in _scattered(rng, _WOODS, 320.0, 420.0):
        color = tree.LEAF_COLORS[int(rng.integers(3))]
        site.put(choice(rng, woods), pose, paint={Material.LEAVES: color})


@lru_cache(maxsize=1)
def _distant_meshes() -> tuple[Mesh, list[Mesh]]:
    """Return a plain building 8 m high, and groups of trees."""
    rng = seeding.generator("backdrop", 0, "woods")
    walls, roof = Skin(BUILDING, Material.FACADE, (150, 150, 150)), Skin(BUILDING, Material.ROOF, (96, 84, 78))
    leaves = Skin(VEGETATION, Material.LEAVES, (70, 92, 52))
    woods = [blob(rng, (15, 11, 9), (0, 0, 1), leaves, 0.25, 8, 4) for _ in range(4)]
    return box((16, 13, 12), (0, 0, 2), walls, roof), woods


def _scattered(rng: np.random.Generator, count: int, least_m: float, most_m: float) -> list[Pose2]:
    angle, yaw = rng.uniform(0, 2 * np.pi, (2, count))
    distance = rng.uniform(least_m, most_m, count)
    return [Pose2(*row) for row in np.stack([distance * np.cos(angle), distance * np.sin(angle), yaw], 1).tolist()]
