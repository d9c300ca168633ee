"""Buildings: the front is at y = 0 and faces -y (the street); z = 0 is the ground at the door.

Walls (materials FACADE and PLASTER) and roofs (ROOF) get their colours when a building is put up.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from omniocc.seeding import choice
from omniworld.mesh.label import BUILDING
from omniworld.mesh.material import Material
from omniworld.mesh.mesh import Mesh, concatenate, transform
from omniworld.mesh.shape import Color, Number, Skin, box, lathe, panel, quads

_FACE = Skin(BUILDING, Material.FACADE, (205, 192, 172))
_TILES = Skin(BUILDING, Material.ROOF, (110, 84, 72))
_FLAT = Skin(BUILDING, Material.CONCRETE, (112, 108, 104))
STOREY_M = 3.2  # of the prototypes and in the facade texture; buildings are stretched so that storeys are 2.8 to 4 m
_PLINTH_M = 1.6  # depth of foundations, so that no gap shows on slopes
_TRIM = Skin(BUILDING, Material.CONCRETE, (176, 172, 164))
_DARK_GLASS = Skin(BUILDING, Material.GLASS, (58, 72, 84))
_SHEET_COLORS: tuple[Color, ...] = (
    (188, 190, 190),
    (140, 150, 160),
    (170, 160, 140),
    (120, 140, 150),
    (150, 84, 66),
    (206, 200, 186),
)
_DOOR = Skin(BUILDING, Material.WOOD, (92, 60, 44))


def _block(width: float, depth: float, low: Number, high: Number, wall: Skin, roof: Skin, back: Number = 0.0) -> Mesh:
    """Build a body from `low` to `high` whose front is `back` metres behind y = 0."""
    return box((width, depth - back, high - low), (0, (depth + back) / 2, (low + high) / 2), wall, roof)


def _plinth(width: float, depth: float) -> Mesh:
    return box((width + 0.1, depth + 0.1, _PLINTH_M + 0.4), (0, depth / 2, 0.4 - (_PLINTH_M + 0.4) / 2), _TRIM)


def tower(rng: np.random.Generator) -> Mesh:
    """Build offices or flats: shops below, rows of windows, sometimes a set-back top."""
    width, depth = float(rng.uniform(12, 26)), float(rng.uniform(11, 17))
    storeys = int(rng.integers(4, 12))
    height = STOREY_M * storeys
    parts = [
        _plinth(width, depth),
        _block(width, depth, 0, height, _FACE, _FLAT),
        box((width + 0.5, depth + 0.5, 0.4), (0, depth / 2, height + 0.2), _TRIM, _FLAT),
    ]
    if rng.uniform() < 0.5:
        parts.append(_block(0.7 * width, depth - 3, height + 0.4, height + 2 * STOREY_M, _FACE, _FLAT, back=3))
    for _ in range(int(rng.integers(1, 4))):
        size = (float(rng.uniform(1.5, 3)), float(rng.uniform(1.5, 3)), float(rng.uniform(1, 2.4)))
        at = (float(rng.uniform(-0.35, 0.35) * width), float(depth * rng.uniform(0.3, 0.7)), height + 0.4 + size[2] / 2)
        parts.append(box(size, at, Skin(BUILDING, Material.METAL, (134, 138, 140))))
    return concatenate([*parts, *_shops(rng, width), *_balconies(rng, width, storeys)])


def row(rng: np.random.Generator) -> Mesh:
    """Build a terraced town house with a pitched roof along the street."""
    width, depth = float(rng.uniform(6, 10.5)), float(rng.uniform(9, 12))
    storeys = int(rng.integers(2, 5))
    height = STOREY_M * storeys
    parts = [
        _plinth(width, depth),
        _block(width, depth, 0, height, _FACE, _TILES),
        _gable(width, depth, height, float(rng.uniform(2, 3.6)), _TILES, _FACE),
        box((width, 0.3, 0.25), (0, -0.05, height - 0.1), _TRIM),
        _chimney(rng, width, depth, height),
    ]
    lower = _shops(rng, width) if rng.uniform() < 0.5 else _entrance(float(rng.uniform(-0.3, 0.3)) * width)
    return concatenate([*parts, *lower, *_balconies(rng, width, storeys)])


def house(rng: np.random.Generator) -> Mesh:
    """Build a detached house: gable roof, chimney and porch."""
    width, depth = float(rng.uniform(8, 12.5)), float(rng.uniform(7.5, 10.5))
    storeys = int(rng.integers(1, 3))
    height = STOREY_M * storeys - 0.2
    roof = _gable(width, depth, height, float(rng.uniform(2.0, 3.4)), _TILES, _FACE)
    if rng.uniform() < 0.4 and width < 1.3 * depth:
        roof = _turned_gable(width, depth, height, float(rng.uniform(2.2, 3.4)), _TILES, _FACE)
    chimney = _chimney(rng, width, depth, height)
    door = float(rng.uniform(-0.25, 0.25)) * width
    porch = [
        box((2.2, 1.5, 0.14), (door, -0.7, 2.55), _TILES),
        *(box((0.12, 0.12, 2.5), (door + x, -1.35, 1.25), _TRIM) for x in (-0.95, 0.95)),
        box((2.2, 1.4, 0.5), (door, -0.7, -0.1), _TRIM),
    ]
    walls = _block(width, depth, 0, height, _FACE, _TILES)
    return concatenate([_plinth(width, depth), walls, roof, chimney, *_entrance(door), *porch])


def garage(rng: np.random.Generator) -> Mesh:
    """Build a single garage, 3.2 x 5.5 m, its gate to the street."""
    face, gate = Skin(BUILDING, Material.PLASTER, (205, 192, 172)), Skin(BUILDING, Material.METAL, (206, 206, 200))
    height = float(rng.uniform(2.4, 2.8))
    walls = box((3.2, 5.5, height + 1.0), (0, 2.75, height / 2 - 0.5), face, _FLAT)
    roof = box((3.5, 5.8, 0.18), (0, 2.75, height + 0.09), _TRIM)
    return concatenate([walls, box((2.5, 0.05, 2.1), (0, -0.03, 1.05), gate), roof])


def hall(rng: np.random.Generator) -> Mesh:
    """Build an industrial hall: sheet walls, gates, a band of windows, flat or shallow roof."""
    width, depth = float(rng.uniform(20, 34)), float(rng.uniform(13, 24))
    height = float(rng.uniform(5.5, 9))
    color = choice(rng, _SHEET_COLORS)
    face = Skin(BUILDING, Material.METAL if rng.uniform() < 0.6 else Material.BRICK, color)
    cover = Skin(BUILDING, Material.METAL, (118, 120, 122))
    parts = [_plinth(width, depth), _block(width, depth, 0, height, face, cover)]
    if rng.uniform() < 0.5:
        parts.append(_turned_gable(width, depth, height, float(rng.uniform(1, 2)), cover, face))
    else:
        parts.append(box((width + 0.3, depth + 0.3, 0.5), (0, depth / 2, height + 0.1), cover))
    count = max(1, int(width // 8))
    for k in range(count):
        x = (k + 0.5) / count * width - width / 2
        color = choice(rng, ((170, 60, 44), (60, 90, 130), (190, 190, 184)))
        parts.append(box((3.6, 0.1, 3.8), (x, -0.04, 1.9), Skin(BUILDING, Material.METAL, color)))
        parts.append(box((4.0, 0.5, 0.2), (x, -0.2, 4.0), _TRIM))
    parts.append(box((0.92 * width, 0.06, 0.9), (0, -0.03, height - 0.9), _DARK_GLASS))
    stack = lathe([0.5, 0.45, 0], [height, height + 3.5, height + 3.5], 9, _TRIM, (0.3 * width, 0.5 * depth))
    return concatenate([*parts, stack])


def barn(rng: np.random.Generator) -> Mesh:
    """Build a wooden barn with a steep roof and a large gate."""
    width, depth = float(rng.uniform(11, 18)), float(rng.uniform(8, 12))
    height = float(rng.uniform(3.2, 4.6))
    face = Skin(BUILDING, Material.WOOD, choice(rng, ((140, 58, 46), (120, 96, 74), (104, 84, 66))))
    gable = _turned_gable if rng.uniform() < 0.6 else _gable
    paint = (226, 220, 206) if rng.uniform() < 0.4 else (84, 62, 48)
    gate = box((3.2, 0.1, 3.0), (0, -0.04, 1.5), Skin(BUILDING, Material.WOOD, paint))
    roof = gable(width, depth, height, float(rng.uniform(3, 4.5)), _TILES, face)
    return concatenate([_plinth(width, depth), _block(width, depth, 0, height, face, _TILES), roof, gate])


def college(rng: np.random.Generator) -> Mesh:
    """Build a long building of two to four storeys behind a row of columns, as on a campus."""
    width, depth = float(rng.uniform(26, 40)), float(rng.uniform(12, 17))
    height = STOREY_M * int(rng.integers(2, 5))
    stone = Skin(BUILDING, Material.CONCRETE, (206, 200, 188))
    porch = float(rng.uniform(9, 14))
    columns = np.linspace(-porch / 2, porch / 2, int(porch // 2.4) + 1)
    return concatenate(
        [
            _plinth(width, depth),
            _block(width, depth, 0, height, _FACE, _FLAT),
            box((width + 0.7, depth + 0.7, 0.5), (0, depth / 2, height + 0.2), stone, _FLAT),
            box((porch + 1.2, 3.2, 0.5), (0, -1.5, STOREY_M + 0.7), stone),
            box((porch + 1.6, 4.0, 0.6), (0, -1.8, -0.15), stone),
            *(lathe([0.3, 0.26], [0.1, STOREY_M + 0.5], 8, stone, (float(x), -2.7)) for x in columns),
            box((3.0, 0.1, 2.8), (0, -0.04, 1.5), _DARK_GLASS),
        ]
    )


def church(rng: np.random.Generator) -> Mesh:
    """Build a church: a nave with its gable to the street, and a tower with a spire."""
    width, depth = float(rng.uniform(13, 16)), float(rng.uniform(15, 20))
    stone = Skin(BUILDING, Material.BRICK, choice(rng, ((176, 164, 142), (150, 138, 124), (158, 96, 76))))
    nave, high = width - 5.0, float(rng.uniform(6.5, 8.5))
    top = float(rng.uniform(14, 19))
    body = [_block(nave, depth, 0, high, stone, stone), _turned_gable(nave, depth, high, 4.5, _TILES, stone)]
    spire = lathe([3.3, 0], [top, top + float(rng.uniform(6, 10))], 4, Skin(BUILDING, Material.ROOF, (84, 96, 92)))
    tower = [box((5, 5, top + 0.6), (0, 2.5, top / 2 - 0.3), stone), _moved(spire, (0, 2.5))]
    windows = [box((0.9, 0.1, 3.0), (float(x), -0.03, 3.6), _DARK_GLASS) for x in (-nave / 4, nave / 4)]
    windows.append(box((1.8, 0.12, 2.6), (0, -0.03, 1.3), _DOOR))
    left = [_moved(part, (2.5, 0)) for part in (*body, *windows)]
    return concatenate([_plinth(width, depth), *left, *(_moved(part, (2.5 - width / 2, 0.4)) for part in tower)])


def _moved(mesh: Mesh, shift_m: tuple[Number, Number]) -> Mesh:
    pose = np.eye(4)
    pose[:2, 3] = shift_m
    return transform(mesh, pose)


def _gable(width: float, depth: float, height: Number, rise: Number, tiles: Skin, wall: Skin) -> Mesh:
    """Build a roof whose ridge runs along the street, its triangles closed with wall."""
    over, x, low = 0.4, width / 2 + 0.3, height - 0.12
    ridge = [(-x, depth / 2, height + rise), (x, depth / 2, height + rise)]
    front, back = [(-x, -over, low), (x, -over, low)], [(-x, depth + over, low), (x, depth + over, low)]
    run = float(np.hypot(depth / 2 + over, rise + 0.12))
    panes = np.array([[front[0], front[1], ridge[1], ridge[0]], [back[1], back[0], ridge[0], ridge[1]]])
    under = panes[:, ::-1] - np.array([0, 0, 0.12])
    uv = np.array([[0, 0], [2 * x, 0], [2 * x, run], [0, run]])
    half = width / 2
    right = [[half, 0, height], [half, depth, height], [half, depth / 2, height + rise - 0.15]]
    left = [[-half, depth, height], [-half, 0, height], [-half, depth / 2, height + rise - 0.15]]
    ends = np.array([right, left])
    ends = np.concatenate([ends, ends[:, 2:]], 1)
    both = np.stack([uv, uv])
    return concatenate(
        [quads(panes, both, tiles), quads(under, both[:, ::-1], tiles), quads(ends, ends[..., 1:], wall)]
    )


def _turned_gable(width: float, depth: float, height: Number, rise: Number, tiles: Skin, wall: Skin) -> Mesh:
    """Build a roof whose ridge runs away from the street, so that a gable faces the street."""
    roof = _gable(depth, width, height, rise, tiles, wall)
    turned = roof.vertices[:, [1, 0, 2]] * np.array([-1, 1, 1], np.float32)
    return replace(roof, vertices=turned + np.array([width / 2, depth / 2, 0], np.float32))


def _chimney(rng: np.random.Generator, width: float, depth: float, height: float) -> Mesh:
    brick = Skin(BUILDING, Material.BRICK, (140, 84, 66))
    return box((0.7, 0.7, 4.2), (float(rng.uniform(-0.35, 0.35)) * width, 0.6 * depth, height + 1.9), brick)


def _entrance(x: Number) -> list[Mesh]:
    return [box((1.1, 0.08, 2.2), (x, -0.05, 1.1), _DOOR), box((1.4, 0.16, 0.14), (x, -0.08, 2.3), _TRIM)]


def _shops(rng: np.random.Generator, width: float) -> list[Mesh]:
    """Build shop windows with name boards and some awnings."""
    parts, count = [], max(1, int(width // 5))
    for k in range(count):
        x, span = (k + 0.5) / count * width - width / 2, 0.84 * width / count
        color = choice(rng, ((150, 40, 40), (36, 84, 68), (40, 60, 110), (200, 160, 70), (70, 70, 74)))
        parts.append(panel((span, 0.08, 2.1), (x, -0.05, 1.4), _DARK_GLASS, "f"))
        parts.append(panel((span, 0.18, 0.5), (x, -0.1, 2.75), Skin(BUILDING, Material.SIGN, color), "frltd"))
        parts += [panel((0.14, 0.2, 2.6), (x + s * span / 2, -0.08, 1.3), _TRIM, "frl") for s in (-1, 1)]
        if rng.uniform() < 0.4:
            parts.append(box((span, 0.8, 0.08), (x, -0.5, 2.5), Skin(BUILDING, Material.CLOTH, color)))
    return parts


def _balconies(rng: np.random.Generator, width: float, storeys: int) -> list[Mesh]:
    """Build stacks of balconies on about half of the fronts."""
    if rng.uniform() < 0.5 or storeys < 3:
        return []
    parts = []
    rail = Skin(BUILDING, Material.METAL, (70, 74, 78))
    for x in (-0.28 * width, 0.28 * width):
        for k in range(1, min(storeys, 6)):
            z = STOREY_M * k
            parts.append(panel((2.6, 0.9, 0.15), (x, -0.45, z), _TRIM, "frltd"))
            parts.append(panel((2.6, 0.05, 0.9), (x, -0.88, z + 0.5), rail, "fb"))
    return parts


KINDS: dict[str, Callable[[np.random.Generator], Mesh]] = {
    "tower": tower,
    "row": row,
    "house": house,
    "garage": garage,
    "hall": hall,
    "barn": barn,
    "college": college,
    "church": church,
}


def footprint_m(mesh: Mesh) -> tuple[float, float]:
    """Return width and depth of a building's foundation."""
    base = mesh.vertices[mesh.vertices[:, 2] < mesh.vertices[:, 2].min() + 0.01]
    width, depth = np.ptp(base[:, :2], axis=0)
    return float(width), float(depth)
