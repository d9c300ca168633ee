"""The country around the town, so that no street ends in the sky."""

import numpy as np

from omniocc.world import tree
from omniocc.world.material import Material
from omniocc.world.shape import Skin, blob, box
from omniocc.world.site import Pose2, Site
from omniocc.world.stock import Stock, one, pick
from omniocc.world.theme import Theme

_TREES, _HOUSES, _WOODS = 90, 60, 70


def fill(theme: Theme, site: Site, stock: Stock, rng: np.random.Generator) -> None:
    """Scatters trees, plain buildings and, further out, woods between 190 and 420 m from the middle."""
    for _ in range(_TREES):
        pose = _somewhere(rng, 190, 300)
        if site.plan.claim(pose, (4.0, 4.0)):
            color = tree.LEAF_COLORS[int(rng.integers(len(tree.LEAF_COLORS)))]
            site.put(one(rng, stock.trees[pick(rng, theme.trees)]), pose, material=Material.LEAVES, color=color)
    height_m = 24.0 if theme.name == "downtown" else 8.0
    blocks = [
        box(
            (16, 13, h + 4),
            (0, 0, h / 2 - 2),
            Skin(4, Material.FACADE, (150, 150, 150)),
            Skin(4, Material.ROOF, (96, 84, 78)),
        )
        for h in height_m * rng.uniform(0.6, 1.5, 5)
    ]
    for _ in range(_HOUSES):
        pose = _somewhere(rng, 200, 330)
        if site.plan.claim(pose, (17.0, 14.0)):
            color = theme.wall_colors[int(rng.integers(len(theme.wall_colors)))]
            site.put(one(rng, blocks), pose, material=Material.FACADE, color=color)
    woods = [blob(rng, (15, 11, 9), (0, 0, 1), Skin(6, Material.LEAVES, (70, 92, 52)), 0.25, 8, 4) for _ in range(4)]
    for _ in range(_WOODS):
        color = tree.LEAF_COLORS[int(rng.integers(3))]
        site.put(one(rng, woods), _somewhere(rng, 320, 420), material=Material.LEAVES, color=color)


def _somewhere(rng: np.random.Generator, least_m: float, most_m: float) -> Pose2:
    angle, distance = rng.uniform(0, 2 * np.pi), rng.uniform(least_m, most_m)
    return Pose2(float(distance * np.cos(angle)), float(distance * np.sin(angle)), float(rng.uniform(0, 2 * np.pi)))
