"""Traffic islands on junctions, and medians with guard rails along the middle of streets."""

import numpy as np

from omniocc.seeding import choice
from omniworld.assets.barrier import PIECE_M
from omniworld.assets.catalog import random_variant
from omniworld.assets.tree import LEAF_COLORS
from omniworld.mesh.label import GROUND, SIDEWALK, WALL
from omniworld.mesh.material import Material
from omniworld.mesh.mesh import Mesh, concatenate
from omniworld.mesh.shape import Skin, lathe, sheet
from omniworld.town.network import Network, center_line, degrees
from omniworld.town.road import CROWN_M
from omniworld.town.site import Pose2, Site
from omniworld.town.terrain import Terrain
from omniworld.town.theme import Theme


def islands(theme: Theme, network: Network, site: Site, rng: np.random.Generator) -> Mesh:
    """Build grass behind a kerb, with shrubs, in the middle of every junction of four streets."""
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
