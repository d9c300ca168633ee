"""Light after dark: street lamps and the pools of light under them, car lights, windows."""

import numpy as np

from omniocc.world.mesh.material import Material
from omniocc.world.mesh.mesh import Mesh
from omniocc.world.render.light import Light
from omniocc.world.render.surface import COLOR, EMITTED, GLAZED, UP

_WARM = np.array([1.0, 0.78, 0.50], np.float32)
_CELL_M = 0.5
_SIDE = 1024  # cells; the map repeats after 512 m
_POOL_M = 20.0
_HEIGHT_M = 6.0


def lamp_pools(mesh: Mesh) -> np.ndarray:
    """Return (1024 * 1024,) float32 light on level ground from the lamps above it, 1 right below a lamp.

    It is looked up by `lamp_light`.
    """
    corner = mesh.vertices[mesh.faces[mesh.material == Material.LAMP]]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    down = normal[:, 2] < -0.5 * np.linalg.norm(normal, axis=1)
    places = np.unique(np.rint(corner[down].mean(axis=1)[:, :2]).astype(np.int64), axis=0)
    pools = np.zeros((_SIDE, _SIDE), np.float32)
    steps = np.arange(-int(_POOL_M / _CELL_M), int(_POOL_M / _CELL_M) + 1)
    distance = np.hypot(*np.meshgrid(steps * _CELL_M, steps * _CELL_M))
    rim = np.clip((_POOL_M - distance) / 8, 0, 1)
    stamp = (rim * (1 + (distance / _HEIGHT_M) ** 2) ** -1.5).astype(np.float32)
    for x, y in places:
        rows, columns = ((np.floor(value / _CELL_M).astype(int) + steps) % _SIDE for value in (x, y))
        pools[np.ix_(rows, columns)] = np.maximum(pools[np.ix_(rows, columns)], stamp)
    return pools.ravel()


def lamp_light(
    light: Light, base: np.ndarray, added: np.ndarray, tint: np.ndarray, attributes: np.ndarray, points: np.ndarray
) -> np.ndarray:
    """Return the (3, R) light after dark from surfaces that shine or are below a lamp.

    `base` (3, R) is the colour of the surfaces with their texture, `tint` (R,) the texture's factor in it, 0 in
    windows, and `added` (3, R) the texture's own colour; panes with bright curtains count as lit rooms. `attributes`
    (16, R) are those of `Surfaces`, `points` (3, R) world points.
    """
    shining = attributes[COLOR] * attributes[EMITTED]
    window = (attributes[GLAZED] > 0) & (tint < 0.02) & (added[0] > 0.1)
    shining += (added * _WARM[:, None]) * (np.float32(2.2) * window)
    if light.pools is not None:
        row, column = (np.floor(axis * np.float32(1 / _CELL_M)).astype(np.int32) & (_SIDE - 1) for axis in points[:2])
        pool = light.pools[row * _SIDE + column] * (0.25 + 0.75 * np.maximum(attributes[UP], 0))
        shining += base * (0.9 * _WARM[:, None] * pool)
    return shining * np.float32(light.lamps)
