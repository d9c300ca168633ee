"""A railway on pillars that crosses the town above its streets."""

import numpy as np

from omniworld.mesh.label import OTHER
from omniworld.mesh.material import Material
from omniworld.mesh.mesh import Mesh
from omniworld.mesh.shape import Skin, box, sheet
from omniworld.town.line import arc_lengths
from omniworld.town.network import Network
from omniworld.town.site import Pose2, Site

_SPAN_M, _CLEARANCE_M, _HALF_WIDTH_M = 11.0, 5.4, 4.2
_CONCRETE = Skin(OTHER, Material.CONCRETE, (150, 148, 142))
_PILLAR = box((1.3, 1.3, 1.0), (0, 0, 0.5), _CONCRETE)


def railway(network: Network, site: Site) -> Mesh:
    """Build a deck on pillars that crosses the middles of parallel streets; it takes the land under it."""
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
    """Build beam, slab and parapets as one profile drawn along the line."""
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
