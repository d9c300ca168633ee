"""Walking people as a short loop of poses, facing +x, their feet on z = 0."""

import numpy as np

from omniocc.seeding import choice
from omniworld.mesh.label import PEDESTRIAN
from omniworld.mesh.material import Material
from omniworld.mesh.mesh import Mesh, concatenate
from omniworld.mesh.shape import Color, Skin, beam, blob, lathe

PHASES = 10
_CHILD_FRACTION = 0.2
STRIDE_M = 1.5  # two steps: once through the loop of poses
_CLOTHES: tuple[Color, ...] = (
    (168, 52, 44),
    (44, 62, 104),
    (60, 60, 64),
    (214, 206, 190),
    (92, 116, 84),
    (198, 158, 66),
    (120, 70, 110),
    (70, 128, 150),
)
_SKINS: tuple[Color, ...] = ((226, 184, 154), (198, 150, 122), (142, 100, 76), (92, 64, 50))
_HAIR: tuple[Color, ...] = ((40, 32, 28), (92, 64, 40), (170, 130, 80), (120, 120, 120))


def walking(rng: np.random.Generator) -> list[Mesh]:
    """Build one person in `PHASES` poses of a stride; the first pose also serves for standing."""
    height = float(rng.uniform(1.1, 1.5) if rng.uniform() < _CHILD_FRACTION else rng.uniform(1.5, 1.98))
    tops, legs = (_CLOTHES[int(k)] for k in rng.integers(len(_CLOTHES), size=2))
    coat = Skin(PEDESTRIAN, Material.CLOTH, tops)
    trousers = Skin(PEDESTRIAN, Material.CLOTH, tuple(int(0.55 * c) for c in legs))  # pyright: ignore[reportArgumentType]
    skin = Skin(PEDESTRIAN, Material.SKIN, choice(rng, _SKINS))
    hair = Skin(PEDESTRIAN, Material.CLOTH, choice(rng, _HAIR))
    wide = float(rng.uniform(0.85, 1.15))
    levels = [h * height for h in (0.45, 0.46, 0.52, 0.62, 0.79, 0.84)]
    still = [
        lathe([0.0, *(r * wide for r in (0.15, 0.17, 0.14, 0.19)), 0.06], levels, 8, coat),
        blob(rng, (0.1, 0.085, 0.125), (0.01, 0, 0.925 * height), skin, 0.02, sides=8, rows=6),
        blob(rng, (0.105, 0.1, 0.085), (-0.02, 0, 0.965 * height), hair, 0.05, sides=8, rows=5),
    ]
    if rng.uniform() < 0.3:
        backpack = Skin(PEDESTRIAN, Material.CLOTH, legs)
        still.append(blob(rng, (0.12, 0.16, 0.22), (-0.22, 0, 0.7 * height), backpack, 0.05))
    poses = []
    for phase in range(PHASES):
        swing = 0.45 * np.sin(2 * np.pi * phase / PHASES)
        limbs = [
            part for side in (-1, 1) for part in _limbs(side, side * swing, height, wide, coat, trousers, skin=skin)
        ]
        poses.append(concatenate(still + limbs))
    return poses


def size_m(poses: list[Mesh]) -> tuple[float, float, float]:
    """Return length, width and height (m) of a box around all poses; the body is in its middle."""
    points = np.concatenate([mesh.vertices for mesh in poses])
    length, width = 2 * np.abs(points[:, :2]).max(0)
    return float(length), float(width), float(points[:, 2].max())


def _limbs(side: int, swing: float, height: float, wide: float, coat: Skin, trousers: Skin, skin: Skin) -> list[Mesh]:
    """Build the leg and the arm of one side; the leg swings by an angle in radians, the arm the other way."""
    y, hip, shoulder = 0.085 * side * wide, 0.49 * height, 0.79 * height
    knee = (0.25 * height * np.sin(swing), y, hip - 0.25 * height * np.cos(swing))
    lower = swing - 0.5 * max(0.0, -swing) - 0.05
    foot = (knee[0] + 0.235 * height * np.sin(lower), y, knee[2] - 0.235 * height * np.cos(lower))
    elbow = (0.16 * height * np.sin(-swing), 0.23 * side * wide, shoulder - 0.17 * height)
    hand = (elbow[0] + 0.15 * height * np.sin(0.35 - swing), 0.24 * side * wide, elbow[2] - 0.15 * height)
    shoe = Skin(PEDESTRIAN, Material.RUBBER, (40, 36, 34))
    return [
        beam((0, y, hip), knee, 0.085 * wide, trousers),
        beam(knee, foot, 0.065 * wide, trousers),
        beam((foot[0] - 0.08, y, foot[2]), (foot[0] + 0.17, y, foot[2]), 0.05, shoe),
        beam((0, 0.19 * side * wide, shoulder), elbow, 0.055, coat),
        beam(elbow, hand, 0.045, skin),
    ]
