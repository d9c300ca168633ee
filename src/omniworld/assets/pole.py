"""Lamp posts, utility poles, signs and traffic lights."""

from collections.abc import Callable

import numpy as np

from omniocc.seeding import choice
from omniworld.mesh.label import POLE
from omniworld.mesh.material import Material
from omniworld.mesh.mesh import Mesh, concatenate
from omniworld.mesh.shape import Color, Skin, beam, box, lathe, panel, triangles

_STEEL = Skin(POLE, Material.METAL, (112, 116, 118))
_DARK = Skin(POLE, Material.METAL, (46, 50, 52))
SIGN_COLORS: tuple[Color, ...] = ((196, 34, 38), (30, 80, 160), (222, 180, 40), (236, 236, 232), (28, 118, 74))


def street_lamp(rng: np.random.Generator) -> Mesh:
    """Build a tall post whose arm carries the light along +y."""
    height, reach = float(rng.uniform(6.5, 9)), float(rng.uniform(1.2, 2.2))
    head = box((0.26, 0.7, 0.12), (0, reach + 0.2, height + 0.25), _DARK)
    light = box((0.2, 0.5, 0.03), (0, reach + 0.2, height + 0.175), Skin(POLE, Material.LAMP, (255, 236, 190)))
    post = lathe([0.16, 0.16, 0.1, 0.06, 0], [-0.3, 0.6, 0.65, height, height], 6, _STEEL)
    return concatenate([post, beam((0, 0, height - 0.05), (0, reach, height + 0.25), 0.05, _STEEL), head, light])


def park_lamp(rng: np.random.Generator) -> Mesh:
    """Build a low post with a globe."""
    height = float(rng.uniform(3.2, 4.2))
    post = lathe([0.12, 0.12, 0.06, 0.05], [-0.3, 0.4, 0.45, height], 5, _DARK)
    globe = lathe(
        [0.05, 0.22, 0.26, 0.2, 0],
        [height, height + 0.08, height + 0.25, height + 0.42, height + 0.48],
        6,
        Skin(POLE, Material.LAMP, (250, 240, 214)),
    )
    return concatenate([post, globe])


def sign(rng: np.random.Generator) -> Mesh:
    """Build a traffic sign that faces +x: disc, triangle or square."""
    height = float(rng.uniform(2.2, 2.7))
    face = Skin(POLE, Material.SIGN, choice(rng, SIGN_COLORS))
    post = lathe([0.04, 0.04], [-0.3, height + 0.35], 5, _STEEL)
    sides = int(rng.choice([3, 4, 9]))
    angle = np.linspace(0, 2 * np.pi, sides, endpoint=False) + np.pi / 2 + (np.pi / 4 if sides == 4 else 0)
    rim = 0.36 * np.stack([np.cos(angle), np.sin(angle)], 1)
    board = _board(rim, (0.07, height), face)
    inner = _board(0.7 * rim, (0.085, height), Skin(POLE, Material.SIGN, (238, 238, 232)))
    return concatenate([post, board, inner])


def _board(rim: np.ndarray, place: tuple[float, float], skin: Skin) -> Mesh:
    """Build a two-sided plate over an outline in (y, z), at x = place[0], centred at z = place[1]."""
    points = np.column_stack([np.full(len(rim), place[0]), rim[:, 0], rim[:, 1] + place[1]])
    corners = np.stack([np.broadcast_to(points.mean(0), points.shape), points, np.roll(points, -1, 0)], 1)
    behind = corners[:, ::-1] - np.array([0.01, 0, 0])
    both = np.concatenate([corners, behind])
    return triangles(both, both[..., 1:], skin)


_LIGHT_M, _ARM_M = 5.6, 3.2
_HEADS = ((0.0, 2.9), (-_ARM_M, _LIGHT_M - 0.15))
SIGNALS: tuple[Color, ...] = ((230, 40, 30), (240, 180, 30), (40, 210, 90))
"""Colours of the red, yellow and green lamp."""


def traffic_light(rng: np.random.Generator) -> Mesh:
    """Build a post with a head on it and one on an arm along -y, facing +x, all lamps dark (see `lit_lamps`)."""
    shade = int(rng.integers(38, 60))
    dark = Skin(POLE, Material.METAL, (shade, shade + 4, shade + 6))
    parts = [
        lathe([0.14, 0.1, 0.07, 0], [-0.3, 0.5, _LIGHT_M, _LIGHT_M], 6, dark),
        beam((0, 0, _LIGHT_M - 0.1), (0, -_ARM_M, _LIGHT_M), 0.05, dark),
    ]
    parts += [box((0.24, 0.3, 0.9), (0.18 * (y == 0), y, z), dark) for y, z in _HEADS]
    for k, color in enumerate(SIGNALS):
        parts += _lamps(k, Skin(POLE, Material.SIGN, (color[0] // 4, color[1] // 4, color[2] // 4)), 0.14)
    return concatenate(parts)


def _lamps(number: int, skin: Skin, out_m: float) -> list[Mesh]:
    z_m = 0.28 - 0.28 * number
    return [panel((0.04, 0.18, 0.18), (0.18 * (y == 0) + out_m, y, z + z_m), skin, "frltd") for y, z in _HEADS]


def lit_lamps(number: int) -> Mesh:
    """Build the lit lamps of a traffic light that shows red (0), yellow (1) or green (2)."""
    return concatenate(_lamps(number, Skin(POLE, Material.LAMP, SIGNALS[number]), 0.15))


def utility_pole(rng: np.random.Generator) -> Mesh:
    """Build a wooden pole with cross arms."""
    height = float(rng.uniform(7.5, 9))
    wood = Skin(POLE, Material.WOOD, (112, 88, 66))
    parts = [lathe([0.15, 0.11, 0], [-0.4, height, height], 7, wood)]
    parts += [box((0.1, 1.8, 0.12), (0, 0, z), wood) for z in (height - 0.4, height - 1.0)]
    parts += [
        lathe([0.04, 0.05, 0], [z + 0.06, z + 0.2, z + 0.22], 5, _DARK, (0, y))
        for z in (height - 0.4, height - 1.0)
        for y in (-0.8, 0.8)
    ]
    return concatenate(parts)


KINDS: dict[str, Callable[[np.random.Generator], Mesh]] = {
    "street": street_lamp,
    "park": park_lamp,
    "utility": utility_pole,
    "sign": sign,
    "light": traffic_light,
}
