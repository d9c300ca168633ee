"""Walls, fences, guard rails and hedges: pieces of `PIECE_M` along x, centred, to be set end to end."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from omniocc.seeding import choice
from omniworld.assets.tree import LEAVES
from omniworld.mesh.label import WALL
from omniworld.mesh.material import Material
from omniworld.mesh.mesh import Mesh, concatenate
from omniworld.mesh.shape import Skin, blob, box, panel

PIECE_M = 4.0


def brick_wall(rng: np.random.Generator) -> Mesh:
    """Build a masonry wall with a coping."""
    height = float(rng.uniform(0.9, 2.1))
    wall = Skin(WALL, Material.BRICK, choice(rng, ((150, 84, 64), (172, 160, 140), (128, 96, 82))))
    coping = Skin(WALL, Material.CONCRETE, (160, 156, 148))
    return concatenate(
        [
            panel((PIECE_M + 0.04, 0.24, height + 0.5), (0, 0, height / 2 - 0.25), wall, "frbl"),
            box((PIECE_M + 0.06, 0.34, 0.1), (0, 0, height + 0.05), coping),
        ]
    )


def concrete_wall(rng: np.random.Generator) -> Mesh:
    """Build a wall of precast panels between posts."""
    height = float(rng.uniform(1.8, 2.6))
    slab, post = Skin(WALL, Material.CONCRETE, (164, 162, 156)), Skin(WALL, Material.CONCRETE, (140, 138, 132))
    return concatenate(
        [
            panel((PIECE_M + 0.04, 0.14, height + 0.5), (0, 0, height / 2 - 0.25), slab, "frbt"),
            panel((0.24, 0.28, height + 0.6), (-PIECE_M / 2, 0, height / 2 - 0.2), post, "frblt"),
        ]
    )


def picket_fence(rng: np.random.Generator) -> Mesh:
    """Build a fence of upright wooden boards on two rails."""
    height = float(rng.uniform(0.85, 1.3))
    color = choice(rng, ((226, 224, 216), (136, 104, 76), (104, 88, 74)))
    wood = Skin(WALL, Material.WOOD, color)
    along = np.arange(-1.8, 2.0, 0.4).tolist()
    boards = [panel((0.2, 0.025, height), (x, 0.04, height / 2 + 0.06), wood, "fbt") for x in along]
    rails = [panel((PIECE_M + 0.04, 0.05, 0.08), (0, 0, z * height), wood, "fbtd") for z in (0.3, 0.8)]
    return concatenate([*boards, *rails, _post(0.1, height, wood)])


def board_fence(rng: np.random.Generator) -> Mesh:
    """Build a closed wooden fence."""
    height = float(rng.uniform(1.5, 1.9))
    wood = Skin(WALL, Material.WOOD, choice(rng, ((140, 108, 78), (118, 94, 74), (150, 136, 116))))
    return concatenate(
        [
            panel((PIECE_M + 0.02, 0.05, height + 0.2), (0, 0, height / 2 - 0.1), wood, "fbt"),
            _post(0.12, height, wood),
        ]
    )


def mesh_fence(rng: np.random.Generator) -> Mesh:
    """Build a fence of steel posts, rails and thin bars."""
    height = float(rng.uniform(1.6, 2.2))
    steel = Skin(WALL, Material.METAL, choice(rng, ((70, 96, 80), (120, 124, 126), (52, 56, 60))))
    along = np.arange(-1.5, 2.0, 0.5).tolist()
    bars = [panel((0.04, 0.03, height - 0.1), (x, 0, height / 2), steel, "frbl") for x in along]
    rails = [panel((PIECE_M + 0.02, 0.04, 0.05), (0, 0, z), steel, "fbt") for z in (0.15, height)]
    return concatenate([*bars, *rails, _post(0.08, height, steel)])


def rail_fence(rng: np.random.Generator) -> Mesh:
    """Build a fence of three bars between posts, as around pastures."""
    height = float(rng.uniform(1.1, 1.4))
    wood = Skin(WALL, Material.WOOD, (124, 102, 80))
    rails = [panel((PIECE_M + 0.04, 0.06, 0.12), (0, 0, z * height), wood, "fbtd") for z in (0.3, 0.62, 0.94)]
    return concatenate([*rails, _post(0.14, height, wood)])


def guard_rail(rng: np.random.Generator) -> Mesh:
    """Build a guard rail of corrugated steel on short posts."""
    height = float(rng.uniform(0.65, 0.75))
    steel = Skin(WALL, Material.METAL, (168, 172, 174))
    bands = [panel((PIECE_M + 0.06, 0.06, 0.13), (0, -0.05, z), steel, "ftd") for z in (height - 0.09, height - 0.27)]
    web = panel((PIECE_M + 0.06, 0.02, 0.3), (0, -0.02, height - 0.18), steel, "fbt")
    post = panel((0.1, 0.12, height + 0.4), (-PIECE_M / 2, 0.05, height / 2 - 0.2), steel, "rblt")
    return concatenate([*bands, web, post])


def _post(width: float, height: float, skin: Skin) -> Mesh:
    return panel((width, width, height + 0.5), (-PIECE_M / 2, 0, height / 2 - 0.2), skin, "frblt")


def median_rail(rng: np.random.Generator) -> Mesh:
    """Build a guard rail with bands on both sides, for the middle of a street."""
    half = guard_rail(rng)
    mirrored = half.vertices * np.array([-1, -1, 1], np.float32)
    return concatenate([half, replace(half, vertices=mirrored)])


def hedge(rng: np.random.Generator) -> Mesh:
    """Build a clipped hedge 1 to 1.7 m high (class vegetation)."""
    height, width = float(rng.uniform(1.0, 1.7)), float(rng.uniform(0.6, 0.8))
    return concatenate(
        [
            panel((PIECE_M + 0.05, width, height + 0.3), (0, 0, height / 2 - 0.15), LEAVES, "frblt"),
            blob(rng, (0.55 * PIECE_M, 0.42 * width, 0.16), (0, 0, height), LEAVES, 0.3, sides=8, rows=3),
        ]
    )


KINDS: dict[str, Callable[[np.random.Generator], Mesh]] = {
    "brick": brick_wall,
    "concrete": concrete_wall,
    "picket": picket_fence,
    "board": board_fence,
    "mesh": mesh_fence,
    "rail": rail_fence,
    "guard": guard_rail,
    "median": median_rail,
    "hedge": hedge,
}
