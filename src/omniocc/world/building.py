"""Buildings. The front stands on y = 0 and looks along -y (to the street); z = 0 is the ground at the door."""

import numpy as np

from omniocc.world.material import Material
from omniocc.world.mesh import Mesh, concatenate
from omniocc.world.shape import Color, Skin, box, lathe, quads

_BUILDING = 4
STOREY_M = 3.0
_PLINTH_M = 1.6  # foundations reach this deep, for slopes
_TRIM = Skin(_BUILDING, Material.CONCRETE, (176, 172, 164))
_DARK_GLASS = Skin(_BUILDING, Material.GLASS, (58, 72, 84))
_DOOR = Skin(_BUILDING, Material.WOOD, (92, 60, 44))


def _block(width: float, depth: float, low: float, high: float, wall: Skin, roof: Skin, back: float = 0.0) -> Mesh:
    """A body from `low` to `high` whose front is `back` behind y = 0."""
    return box((width, depth - back, high - low), (0, (depth + back) / 2, (low + high) / 2), wall, roof)


def _plinth(width: float, depth: float) -> Mesh:
    return box((width + 0.1, depth + 0.1, _PLINTH_M + 0.4), (0, depth / 2, 0.4 - (_PLINTH_M + 0.4) / 2), _TRIM)


def tower(rng: np.random.Generator, width: float, depth: float, wall: Color, roof: Color) -> Mesh:
    """Offices or flats: shops below, rows of windows, sometimes a set-back top."""
    storeys = int(rng.integers(4, 12))
    height = STOREY_M * storeys
    face, top = Skin(_BUILDING, Material.FACADE, wall), Skin(_BUILDING, Material.CONCRETE, roof)
    parts = [_plinth(width, depth), _block(width, depth, 0, height, face, top)]
    parts.append(box((width + 0.5, depth + 0.5, 0.4), (0, depth / 2, height + 0.2), _TRIM, top))
    if rng.uniform() < 0.5 and width > 12:
        inner = _block(0.7 * width, depth - 3, height + 0.4, height + 2 * STOREY_M, face, top, back=3)
        parts.append(inner)
    for _ in range(int(rng.integers(1, 4))):
        size = (float(rng.uniform(1.5, 3)), float(rng.uniform(1.5, 3)), float(rng.uniform(1, 2.4)))
        at = (float(rng.uniform(-0.35, 0.35) * width), float(depth * rng.uniform(0.3, 0.7)), height + 0.4 + size[2] / 2)
        parts.append(box(size, at, Skin(_BUILDING, Material.METAL, (134, 138, 140))))
    return concatenate([*parts, *_shops(rng, width), *_balconies(rng, width, storeys)])


def row(rng: np.random.Generator, width: float, depth: float, wall: Color, roof: Color) -> Mesh:
    """A terraced town house with a pitched roof along the street."""
    storeys = int(rng.integers(2, 5))
    height = STOREY_M * storeys
    face = Skin(_BUILDING, Material.FACADE, wall)
    tiles = Skin(_BUILDING, Material.ROOF, roof)
    parts = [
        _plinth(width, depth),
        _block(width, depth, 0, height, face, tiles),
        _gable(width, depth, height, float(rng.uniform(2, 3.6)), tiles, face),
    ]
    parts.append(box((width, 0.3, 0.25), (0, -0.05, height - 0.1), _TRIM))
    parts.append(_chimney(rng, width, depth, height))
    lower = _shops(rng, width) if rng.uniform() < 0.5 else _entrance(float(rng.uniform(-0.3, 0.3)) * width)
    return concatenate([*parts, *lower, *_balconies(rng, width, storeys)])


def house(rng: np.random.Generator, width: float, depth: float, wall: Color, roof: Color) -> Mesh:
    """A detached house: gable roof, porch, perhaps a wing and a garage."""
    storeys = int(rng.integers(1, 3))
    height = STOREY_M * storeys - 0.2
    face, tiles = Skin(_BUILDING, Material.FACADE, wall), Skin(_BUILDING, Material.ROOF, roof)
    body = _gable(width, depth, height, float(rng.uniform(2.0, 3.4)), tiles, face)
    if rng.uniform() < 0.4 and width < 1.3 * depth:
        body = _turned_gable(width, depth, height, float(rng.uniform(2.2, 3.4)), tiles, face)
    parts = [
        _plinth(width, depth),
        _block(width, depth, 0, height, face, tiles),
        body,
        _chimney(rng, width, depth, height),
    ]
    door = float(rng.uniform(-0.25, 0.25)) * width
    parts += _entrance(door)
    parts.append(box((2.2, 1.5, 0.14), (door, -0.7, 2.55), tiles))
    parts += [box((0.12, 0.12, 2.5), (door + x, -1.35, 1.25), _TRIM) for x in (-0.95, 0.95)]
    parts.append(box((2.2, 1.4, 0.5), (door, -0.7, -0.1), _TRIM))
    return concatenate(parts)


def garage(rng: np.random.Generator, wall: Color) -> Mesh:
    """A single garage, 3.2 x 5.5 m, its gate to the street."""
    face, gate = Skin(_BUILDING, Material.PLASTER, wall), Skin(_BUILDING, Material.METAL, (206, 206, 200))
    height = float(rng.uniform(2.4, 2.8))
    return concatenate(
        [
            box(
                (3.2, 5.5, height + 1.0),
                (0, 2.75, height / 2 - 0.5),
                face,
                Skin(_BUILDING, Material.CONCRETE, (112, 108, 104)),
            ),
            box((2.5, 0.05, 2.1), (0, -0.03, 1.05), gate),
            box((3.5, 5.8, 0.18), (0, 2.75, height + 0.09), _TRIM),
        ]
    )


def hall(rng: np.random.Generator, width: float, depth: float, wall: Color, roof: Color) -> Mesh:
    """Industrial hall: sheet walls, gates, a band of windows, shallow or saw-tooth roof."""
    height = float(rng.uniform(5.5, 9))
    face = Skin(_BUILDING, Material.METAL if rng.uniform() < 0.6 else Material.BRICK, wall)
    cover = Skin(_BUILDING, Material.METAL, roof)
    parts = [_plinth(width, depth), _block(width, depth, 0, height, face, cover)]
    if rng.uniform() < 0.5:
        parts.append(_turned_gable(width, depth, height, float(rng.uniform(1, 2)), cover, face))
    else:
        parts.append(box((width + 0.3, depth + 0.3, 0.5), (0, depth / 2, height + 0.1), cover))
    count = max(1, int(width // 8))
    for k in range(count):
        x = (k + 0.5) / count * width - width / 2
        color = ((170, 60, 44), (60, 90, 130), (190, 190, 184))[int(rng.integers(3))]
        parts.append(box((3.6, 0.1, 3.8), (x, -0.04, 1.9), Skin(_BUILDING, Material.METAL, color)))
        parts.append(box((4.0, 0.5, 0.2), (x, -0.2, 4.0), _TRIM))
    parts.append(box((0.92 * width, 0.06, 0.9), (0, -0.03, height - 0.9), _DARK_GLASS))
    stack = lathe([0.5, 0.45, 0], [height, height + 3.5, height + 3.5], 9, _TRIM, (0.3 * width, 0.5 * depth))
    return concatenate([*parts, stack])


def barn(rng: np.random.Generator, width: float, depth: float, wall: Color, roof: Color) -> Mesh:
    """Wooden barn with a steep roof and a large gate."""
    height = float(rng.uniform(3.2, 4.6))
    face = Skin(_BUILDING, Material.WOOD, ((140, 58, 46), (120, 96, 74), (104, 84, 66))[int(rng.integers(3))])
    tiles = Skin(_BUILDING, Material.ROOF, roof)
    gable = _turned_gable if rng.uniform() < 0.6 else _gable
    gate = box(
        (3.2, 0.1, 3.0),
        (0, -0.04, 1.5),
        Skin(_BUILDING, Material.WOOD, (226, 220, 206) if wall[0] > 180 else (84, 62, 48)),
    )
    return concatenate(
        [
            _plinth(width, depth),
            _block(width, depth, 0, height, face, tiles),
            gable(width, depth, height, float(rng.uniform(3, 4.5)), tiles, face),
            gate,
        ]
    )


def _gable(width: float, depth: float, height: float, rise: float, tiles: Skin, wall: Skin) -> Mesh:
    """A roof whose ridge runs along the street, its triangles closed with wall."""
    over, x, low = 0.4, width / 2 + 0.3, height - 0.12
    ridge = [(-x, depth / 2, height + rise), (x, depth / 2, height + rise)]
    front, back = [(-x, -over, low), (x, -over, low)], [(-x, depth + over, low), (x, depth + over, low)]
    run = float(np.hypot(depth / 2 + over, rise + 0.12))
    panes = np.array([[front[0], front[1], ridge[1], ridge[0]], [back[1], back[0], ridge[0], ridge[1]]])
    under = panes[:, ::-1] - np.array([0, 0, 0.12])
    uv = np.array([[0, 0], [2 * x, 0], [2 * x, run], [0, run]])
    half = width / 2
    ends = np.array(
        [
            [[half, 0, height], [half, depth, height], [half, depth / 2, height + rise - 0.15]] * 1,
            [[-half, depth, height], [-half, 0, height], [-half, depth / 2, height + rise - 0.15]],
        ]
    )
    ends = np.concatenate([ends, ends[:, 2:]], 1)
    return concatenate(
        [
            quads(panes, np.stack([uv, uv]), tiles),
            quads(under, np.stack([uv, uv])[:, ::-1], tiles),
            quads(ends, ends[..., 1:], wall),
        ]
    )


def _turned_gable(width: float, depth: float, height: float, rise: float, tiles: Skin, wall: Skin) -> Mesh:
    """The same with the ridge across, so that a gable looks to the street."""
    roof = _gable(depth, width, height, rise, tiles, wall)
    turned = roof.vertices[:, [1, 0, 2]] * np.array([-1, 1, 1], np.float32) + np.array(
        [width / 2, depth / 2, 0], np.float32
    )
    return Mesh(turned, roof.faces, roof.uv, roof.label, roof.material, roof.color, roof.instance)


def _chimney(rng: np.random.Generator, width: float, depth: float, height: float) -> Mesh:
    brick = Skin(_BUILDING, Material.BRICK, (140, 84, 66))
    return box((0.7, 0.7, 4.2), (float(rng.uniform(-0.35, 0.35)) * width, 0.6 * depth, height + 1.9), brick)


def _entrance(x: float) -> list[Mesh]:
    return [box((1.1, 0.08, 2.2), (x, -0.05, 1.1), _DOOR), box((1.4, 0.16, 0.14), (x, -0.08, 2.3), _TRIM)]


def _shops(rng: np.random.Generator, width: float) -> list[Mesh]:
    """Shop windows with name boards and some awnings."""
    parts, count = [], max(1, int(width // 5))
    for k in range(count):
        x, span = (k + 0.5) / count * width - width / 2, 0.84 * width / count
        color = ((150, 40, 40), (36, 84, 68), (40, 60, 110), (200, 160, 70), (70, 70, 74))[int(rng.integers(5))]
        parts.append(box((span, 0.08, 2.1), (x, -0.05, 1.4), _DARK_GLASS))
        parts.append(box((span, 0.18, 0.5), (x, -0.1, 2.75), Skin(_BUILDING, Material.SIGN, color)))
        parts += [box((0.14, 0.2, 2.6), (x + s * span / 2, -0.08, 1.3), _TRIM) for s in (-1, 1)]
        if rng.uniform() < 0.4:
            parts.append(box((span, 0.8, 0.08), (x, -0.5, 2.5), Skin(_BUILDING, Material.CLOTH, color)))
    return parts


def _balconies(rng: np.random.Generator, width: float, storeys: int) -> list[Mesh]:
    """Stacks of balconies on some fronts."""
    if rng.uniform() < 0.5 or storeys < 3:
        return []
    parts = []
    rail = Skin(_BUILDING, Material.METAL, (70, 74, 78))
    for x in (-0.28 * width, 0.28 * width):
        for k in range(1, min(storeys, 6)):
            z = STOREY_M * k
            parts += [box((2.6, 0.9, 0.15), (x, -0.45, z), _TRIM), box((2.6, 0.05, 0.9), (x, -0.88, z + 0.5), rail)]
    return parts
