"""Light after dark: street lamps and the pools of light under them, car lights, windows."""

import numpy as np

from omniworld.mesh.material import Material
from omniworld.mesh.mesh import Mesh

CELL_M = 0.5
SIDE = 1024  # cells; the map repeats after 512 m
_POOL_M = 20.0
_HEIGHT_M = 6.0


def lamp_pools(mesh: Mesh) -> np.ndarray:
    """Return (1024 * 1024,) float32 light on level ground from the lamps above it, 1 right below a lamp.

    It is looked up by `kernel.lamp_shine`.
    """
    corner = mesh.vertices[mesh.faces[mesh.material == Material.LAMP]]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    down = normal[:, 2] < -0.5 * np.linalg.norm(normal, axis=1)
    places = np.unique(np.rint(corner[down].mean(axis=1)[:, :2]).astype(np.int64), axis=0)
    pools = np.zeros((SIDE, SIDE), np.float32)
    steps = np.arange(-int(_POOL_M / CELL_M), int(_POOL_M / CELL_M) + 1)
    distance = np.hypot(*np.meshgrid(steps * CELL_M, steps * CELL_M))
    rim = np.clip((_POOL_M - distance) / 8, 0, 1)
    stamp = (rim * (1 + (distance / _HEIGHT_M) ** 2) ** -1.5).astype(np.float32)
    for x, y in places:
        rows, columns = ((np.floor(value / CELL_M).astype(int) + steps) % SIDE for value in (x, y))
        pools[np.ix_(rows, columns)] = np.maximum(pools[np.ix_(rows, columns)], stamp)
    return pools.ravel()
