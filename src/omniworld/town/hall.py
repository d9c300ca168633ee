"""A hall over the streets: walls along the kerbs and a ceiling, as in a garage, a corridor or a works hall."""

import numpy as np

from omniworld.assets.solid import random_color, random_material
from omniworld.mesh.label import BUILDING
from omniworld.mesh.mesh import Mesh, concatenate
from omniworld.mesh.shape import Skin, panel, sheet
from omniworld.town.line import arc_lengths
from omniworld.town.network import Network
from omniworld.town.terrain import Terrain
from omniworld.town.theme import Theme

_BELOW_M = 2.0  # walls reach into the ground, which is not level
_SIZE_M = 600.0


def hall(theme: Theme, network: Network, terrain: Terrain, rng: np.random.Generator) -> Mesh:
    """Build the walls, some metres behind the kerbs, and one level ceiling, clear of the heads of walkers."""
    ends = [ring.kerb_m for ring in network.rings]
    highest_m = float(terrain.height(*np.concatenate(ends).T).max())
    ceiling_m = highest_m + float(rng.uniform(3.0, 7.0))
    back_m = theme.sidewalk_m + float(rng.uniform(0.2, 2.5))
    parts = [panel((_SIZE_M, _SIZE_M, 0.2), (0, 0, ceiling_m + 0.1), _skin(rng), "d")]
    for ring in network.rings:
        foot = ring.offset(back_m)
        closed = np.concatenate([foot, foot[:1]])
        height_m = np.array([-_BELOW_M, ceiling_m])
        low, high = (np.column_stack([closed, np.full(len(closed), z)]) for z in height_m)
        parts.append(sheet(np.stack([low, high]), np.stack(np.meshgrid(arc_lengths(low), height_m), -1), _skin(rng)))
    return concatenate(parts)


def _skin(rng: np.random.Generator) -> Skin:
    return Skin(BUILDING, random_material(rng), random_color(rng))
