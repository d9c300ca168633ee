"""Walls, fences and guard rails: pieces along x, centred, to be set end to end so that they follow the land."""

from collections.abc import Callable

import numpy as np

from omniocc.world.material import Material
from omniocc.world.mesh import Mesh, concatenate
from omniocc.world.shape import Skin, beam, box

_WALL = 5
PIECE_M = 2.0


def brick_wall(rng: np.random.Generator) -> Mesh:
    """Masonry with a coping."""
    height = float(rng.uniform(0.9, 2.1))
    wall = Skin(_WALL, Material.BRICK, ((150, 84, 64), (172, 160, 140), (128, 96, 82))[int(rng.integers(3))])
    coping = Skin(_WALL, Material.CONCRETE, (160, 156, 148))
    return concatenate([
        box((PIECE_M + 0.04, 0.24, height + 0.5), (0, 0, height / 2 - 0.25), wall),
        box((PIECE_M + 0.06, 0.34, 0.1), (0, 0, height + 0.05), coping),
    ])  # fmt: skip


def concrete_wall(rng: np.random.Generator) -> Mesh:
    """Precast panels between posts."""
    height = float(rng.uniform(1.8, 2.6))
    panel, post = Skin(_WALL, Material.CONCRETE, (164, 162, 156)), Skin(_WALL, Material.CONCRETE, (140, 138, 132))
    return concatenate([
        box((PIECE_M + 0.04, 0.14, height + 0.5), (0, 0, height / 2 - 0.25), panel),
        box((0.24, 0.28, height + 0.6), (-PIECE_M / 2, 0, height / 2 - 0.2), post),
    ])  # fmt: skip


def picket_fence(rng: np.random.Generator) -> Mesh:
    """Upright wooden boards on two rails."""
    height = float(rng.uniform(0.85, 1.3))
    color = ((226, 224, 216), (136, 104, 76), (104, 88, 74))[int(rng.integers(3))]
    wood = Skin(_WALL, Material.WOOD, color)
    boards = [box((0.2, 0.025, height), (float(x), 0.04, height / 2 + 0.06), wood) for x in np.arange(-0.85, 1.0, 0.34)]
    rails = [box((PIECE_M + 0.04, 0.05, 0.08), (0, 0, z * height), wood) for z in (0.3, 0.8)]
    return concatenate([*boards, *rails, box((0.1, 0.1, height + 0.5), (-PIECE_M / 2, 0, height / 2 - 0.2), wood)])


def board_fence(rng: np.random.Generator) -> Mesh:
    """Closed wooden fence."""
    height = float(rng.uniform(1.5, 1.9))
    wood = Skin(_WALL, Material.WOOD, ((140, 108, 78), (118, 94, 74), (150, 136, 116))[int(rng.integers(3))])
    return concatenate([
        box((PIECE_M + 0.02, 0.05, height + 0.2), (0, 0, height / 2 - 0.1), wood),
        box((0.12, 0.12, height + 0.5), (-PIECE_M / 2, 0, height / 2 - 0.2), wood),
    ])  # fmt: skip


def mesh_fence(rng: np.random.Generator) -> Mesh:
    """Steel posts, rails and thin bars."""
    height = float(rng.uniform(1.6, 2.2))
    steel = Skin(_WALL, Material.METAL, ((70, 96, 80), (120, 124, 126), (52, 56, 60))[int(rng.integers(3))])
    bars = [box((0.04, 0.03, height - 0.1), (float(x), 0, height / 2), steel) for x in np.arange(-0.8, 1.0, 0.4)]
    rails = [box((PIECE_M + 0.02, 0.04, 0.05), (0, 0, z), steel) for z in (0.15, height)]
    return concatenate([*bars, *rails, box((0.08, 0.08, height + 0.5), (-PIECE_M / 2, 0, height / 2 - 0.2), steel)])


def rail_fence(rng: np.random.Generator) -> Mesh:
    """Three bars between posts, as around pastures."""
    height = float(rng.uniform(1.1, 1.4))
    wood = Skin(_WALL, Material.WOOD, (124, 102, 80))
    rails = [box((PIECE_M + 0.04, 0.06, 0.12), (0, 0, share * height), wood) for share in (0.3, 0.62, 0.94)]
    return concatenate([*rails, box((0.14, 0.14, height + 0.5), (-PIECE_M / 2, 0, height / 2 - 0.2), wood)])


def guard_rail(rng: np.random.Generator) -> Mesh:
    """Corrugated steel on short posts."""
    height = float(rng.uniform(0.65, 0.75))
    steel = Skin(_WALL, Material.METAL, (168, 172, 174))
    bands = [box((PIECE_M + 0.06, 0.06, 0.13), (0, -0.05, z), steel) for z in (height - 0.09, height - 0.27)]
    web = box((PIECE_M + 0.06, 0.02, 0.3), (0, -0.02, height - 0.18), steel)
    return concatenate([*bands, web, box((0.1, 0.12, height + 0.4), (-PIECE_M / 2, 0.05, height / 2 - 0.2), steel),
                        beam((-1, 0, 0.1), (-1, 0.3, -0.2), 0.03, steel)])  # fmt: skip


KINDS: dict[str, Callable[[np.random.Generator], Mesh]] = {
    "brick": brick_wall, "concrete": concrete_wall, "picket": picket_fence, "board": board_fence,
    "mesh": mesh_fence, "rail": rail_fence, "guard": guard_rail,
}  # fmt: skip
