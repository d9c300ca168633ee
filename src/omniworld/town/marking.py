"""Road lines: lanes, edges, crossings, stop lines and arrows, as strips just above the carriageway."""

import numpy as np

from omniworld.mesh.label import ROADLINE
from omniworld.mesh.material import Material
from omniworld.mesh.mesh import Mesh, concatenate
from omniworld.mesh.shape import Skin, triangles
from omniworld.town.line import interpolate
from omniworld.town.network import Network, Ring, Side
from omniworld.town.road import CROWN_M
from omniworld.town.terrain import Terrain
from omniworld.town.theme import Theme

_RAISED_M = 0.012
_WIDTH_M = 0.2  # wider than real lines, so that they survive the vote in voxels of 0.2 m
_DASH_M, _GAP_M = 3.0, 6.0
CROSSING_M = (0.8, 4.0)  # from the end of the corner along the street
_STOP_M = (4.8, 5.25)
_PAINT = Skin(ROADLINE, Material.PAINT, (226, 224, 214))
_QUAD = np.array([[0, 1, 2], [0, 2, 3]])


def stop_m(zebra: bool) -> float:
    """Return where the fronts of waiting cars stop, from the end of the corner."""
    return (_STOP_M[0] if zebra else 1.0) + 0.6


def build(theme: Theme, terrain: Terrain, network: Network, crossings: frozenset[tuple[int, bool]]) -> Mesh:
    """Build all lines; `crossings` are (street, at its end) of the junction arms with a zebra crossing."""
    return concatenate(
        _half_street(theme, terrain, network, ring, side, crossings) for ring in network.rings for side in ring.sides
    )


def _half_street(
    theme: Theme, terrain: Terrain, network: Network, ring: Ring, side: Side, crossings: frozenset[tuple[int, bool]]
) -> Mesh:
    edge = network.edges[side.edge]
    first, last, width = side.along_m[0], side.along_m[-1], edge.half_width_m - 0.5 * theme.median_m
    at_start, at_end = ((side.edge, side.forward != end) in crossings for end in (True, False))
    begin = first + (_STOP_M[1] if at_start else 1.6)
    end = last - (CROSSING_M[1] + 0.5 if at_end else 0.5)
    solid = np.concatenate([[begin], side.along_m[(side.along_m > begin) & (side.along_m < end)], [end]])
    solid = np.stack([solid[:-1], solid[1:]], 1)
    dashes = _dashes(first + _STOP_M[1], last - _STOP_M[1])
    stop = first + (_STOP_M[0] if at_start else 1.0)
    patches = [_strip(stop, stop + 0.4, theme.parking_m, width - 0.12)]
    if theme.lane_lines:
        patches += [_rectangles(dashes, theme.parking_m + k * theme.lane_width_m) for k in range(edge.lanes)]
        divided = edge.lanes > 1 or theme.median_m > 0
        patches.append(_rectangles(solid, width - 0.22) if divided else _rectangles(dashes, width, one_sided=True))
    for zebra, low, high in (
        (at_start, first + CROSSING_M[0], first + CROSSING_M[1]),
        (at_end, last - CROSSING_M[1], last - CROSSING_M[0]),
    ):
        if zebra:
            patches += [_strip(low, high, d, d + 0.5) for d in np.arange(0.45, width - 0.3, 1.0)]
    if edge.lanes > 1:
        patches += [_arrow(stop + 2.5, theme.parking_m + (k + 0.5) * theme.lane_width_m) for k in range(edge.lanes)]
    return _paint(terrain, side, edge.half_width_m, np.concatenate(patches))


def _dashes(first: float, last: float) -> np.ndarray:
    """Return (D, 2) dashes, symmetric about the street's middle so that both halves of it agree."""
    count = max(int((last - first + _GAP_M) // (_DASH_M + _GAP_M)), 0)
    starts = (first + last) / 2 + (np.arange(count) - count / 2) * (_DASH_M + _GAP_M) + _GAP_M / 2
    return np.stack([starts, starts + _DASH_M], 1)


def _rectangles(spans: np.ndarray, from_kerb_m: float, one_sided: bool = False) -> np.ndarray:
    """Return (2 D, 3, 2) triangles in (along, from kerb) of a broken line; `one_sided` for the street's middle."""
    low, high = from_kerb_m - _WIDTH_M / 2, from_kerb_m + (0 if one_sided else _WIDTH_M / 2)
    (a, b), ones = spans.T, np.ones(len(spans))
    corners = np.stack([np.stack([s, d * ones], 1) for s, d in ((a, high), (b, high), (b, low), (a, low))], 1)
    return corners[:, _QUAD].reshape(-1, 3, 2)


def _strip(first: float, last: float, low: float, high: float) -> np.ndarray:
    return np.array([[first, high], [last, high], [last, low], [first, low]])[_QUAD]


def _arrow(tip: float, from_kerb_m: float) -> np.ndarray:
    """Return the triangles of an arrow straight ahead: cars on this half of the street go towards its start."""
    head = np.array([[tip, from_kerb_m], [tip + 1.1, from_kerb_m - 0.45], [tip + 1.1, from_kerb_m + 0.45]])
    return np.concatenate([head[None], _strip(tip + 1.1, tip + 3.2, from_kerb_m - 0.1, from_kerb_m + 0.1)])


def _paint(terrain: Terrain, side: Side, width_m: float, patches: np.ndarray) -> Mesh:
    """Lay triangles in (along, from kerb) onto the street, which is straight from kerb to centre line."""
    rims = terrain.points(side.kerb_m), terrain.points(side.center_m, CROWN_M)
    low, high = (interpolate(patches[..., 0], side.along_m, rim) for rim in rims)
    corners = low + patches[..., 1:] / width_m * (high - low) + np.array([0, 0, _RAISED_M])
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    corners = np.where((a[:, 0] * b[:, 1] < a[:, 1] * b[:, 0])[:, None, None], corners[:, ::-1], corners)
    return triangles(corners, corners[..., :2], _PAINT)
