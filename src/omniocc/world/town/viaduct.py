"""In the middle of streets and over them: a railway on pillars, islands on junctions, rails between directions."""

import numpy as np

from omniocc.world.assets.barrier import PIECE_M
from omniocc.world.assets.material import Material
from omniocc.world.assets.mesh import Mesh, concatenate
from omniocc.world.assets.shape import Skin, box, lathe, sheet
from omniocc.world.assets.stock import one
from omniocc.world.assets.tree import LEAF_COLORS
from omniocc.world.town.network import Network, center_line, degrees
from omniocc.world.town.road import CROWN_M
from omniocc.world.town.site import Pose2, Site
from omniocc.world.town.terrain import Terrain
from omniocc.world.town.theme import Theme

_SPAN_M, _CLEARANCE_M, _HALF_WIDTH_M = 11.0, 5.4, 4.2
_CONCRETE = Skin(8, Material.CONCRETE, (150, 148, 142))
_PILLAR = box((1.3, 1.3, 1.0), (0, 0, 0.5), _CONCRETE)


def railway(network: Network, site: Site) -> Mesh:
    """A deck on pillars that crosses the middles of parallel streets; takes the land under it."""
    count = round(len(network.junctions_m) ** 0.5)
    grid = network.junctions_m.reshape(count, count, 2)
    first, last = grid[0, 1:3].mean(0), grid[-1, 1:3].mean(0)
    ahead = (last - first) / np.linalg.norm(last - first)
    steps = np.arange(-60.0, np.linalg.norm(last - first) + 60.0, _SPAN_M)
    points = first + steps[:, None] * ahead
    low = site.terrain.height(*points.T)
    level = np.convolve(np.pad(low, 3, "edge"), np.hanning(9)[1:-1] / np.hanning(9).sum(), "valid")
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
    """Beam, slab and parapets as one profile drawn along the line; the parapets are walls."""
    w = _HALF_WIDTH_M
    outline = np.array([(-w, 1.9), (-w, 0.9), (-2.9, 0.0), (2.9, 0.0), (w, 0.9), (w, 1.9), (w - 0.25, 1.9),
                        (w - 0.25, 1.0), (-w + 0.25, 1.0), (-w + 0.25, 1.9), (-w, 1.9)])  # fmt: skip
    xy = points[:, None] + outline[:, :1] * left
    net = np.concatenate([xy, np.broadcast_to((top[:, None] + outline[:, 1])[..., None], (*xy.shape[:2], 1))], -1)
    around = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(outline, axis=0), axis=1))])
    along = _SPAN_M * np.arange(len(points))
    uv = np.stack(np.meshgrid(around, along), -1)
    return sheet(net[::-1], uv[::-1], _CONCRETE)


def islands(theme: Theme, network: Network, site: Site, rng: np.random.Generator) -> Mesh:
    """Grass behind a kerb, with shrubs, in the middle of every junction of four streets."""
    parts = []
    for (x, y), meeting in zip(network.junctions_m.tolist(), degrees(network), strict=True):
        if meeting < 4 or theme.island_m == 0:
            continue
        ground = float(site.terrain.height(x, y)) + CROWN_M
        radius = theme.island_m
        kerb = lathe([radius, radius, radius - 0.9], [ground - 1.0, ground + 0.16, ground + 0.2], 20,
                     Skin(2, Material.CONCRETE, (176, 172, 164)), (x, y))  # fmt: skip
        lawn = lathe([radius - 0.9, 0.5 * radius, 0], [ground + 0.2, ground + 0.55, ground + 0.7], 20,
                     Skin(3, Material.GRASS, (88, 120, 60)), (x, y))  # fmt: skip
        parts += [kerb, lawn]
        for k in range(int(rng.integers(3, 7))):
            pose = Pose2(x, y, k * 1.1).at(float(rng.uniform(0.3, 0.55)) * radius, 0.0, float(rng.uniform(0, 3)))
            kind = "bush" if k else ("conifer", "round", "bush")[int(rng.integers(3))]
            color = LEAF_COLORS[int(rng.integers(len(LEAF_COLORS)))]
            site.put(one(rng, "tree", kind), pose, lift_m=CROWN_M + 0.4, paint={Material.LEAVES: color})
    return concatenate(parts)


def medians(theme: Theme, network: Network, terrain: Terrain, site: Site, rng: np.random.Generator) -> Mesh:
    """A low kerb with a guard rail along the middle of the streets, open near junctions."""
    if theme.median_m == 0:
        return concatenate([])
    parts, rail = [], one(rng, "barrier", "median")
    sides = {side.edge: side for ring in network.rings for side in ring.sides if side.forward}
    for side in sides.values():
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
        parts.append(sheet(net[::-1], uv[::-1], Skin(5, Material.CONCRETE, (158, 156, 150))))
    return concatenate(parts)
