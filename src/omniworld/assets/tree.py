"""Trees and bushes, in metres, on the ground z = 0; their leaves get one of `LEAF_COLORS` when they are planted."""

from collections.abc import Callable

import numpy as np

from omniworld.mesh.label import VEGETATION
from omniworld.mesh.material import Material
from omniworld.mesh.mesh import Mesh, concatenate
from omniworld.mesh.shape import Color, Number, Skin, Triple, blob, lathe

LEAVES = Skin(VEGETATION, Material.LEAVES, (80, 112, 52))
_BARK = Skin(VEGETATION, Material.BARK, (94, 76, 58))
_BIRCH = Skin(VEGETATION, Material.BARK, (198, 194, 184))
LEAF_COLORS: tuple[Color, ...] = (
    (72, 104, 46),
    (92, 120, 52),
    (60, 92, 50),
    (110, 126, 58),
    (84, 104, 66),
    (122, 130, 58),
)


def round_tree(rng: np.random.Generator) -> Mesh:
    """Build a trunk with a broad crown of several lumps."""
    height, crown = rng.uniform(6.5, 10), rng.uniform(1.5, 2.3)
    stem = rng.uniform(2.3, 3.2)
    parts = [lathe([0.24, 0.17, 0.13], [-0.3, 0.5, stem + 0.8], 5, _BARK)]
    for k in range(int(rng.integers(2, 5))):
        angle, out = k * 2.4 + rng.uniform(0, 1), crown * rng.uniform(0.3, 0.55)
        center = _around(out, angle, rng.uniform(stem + 0.75 * crown, height - 0.6 * crown))
        size = crown * rng.uniform(0.55, 0.8)
        parts.append(blob(rng, (size, size, 0.85 * size), center, LEAVES, 0.24, sides=6, rows=4))
    parts.append(blob(rng, (crown * 0.75, crown * 0.75, crown * 0.8), (0, 0, height - 0.8 * crown), LEAVES, 0.22))
    return concatenate(parts)


def tall_tree(rng: np.random.Generator) -> Mesh:
    """Build a trunk with a slender upright crown, such as a poplar has."""
    height, crown, stem = rng.uniform(8, 13), rng.uniform(1.0, 1.6), rng.uniform(2.2, 2.8)
    trunk = lathe([0.22, 0.15], [-0.3, stem + 1], 6, _BARK)
    return concatenate([trunk, blob(rng, *_crown(height, crown, stem), LEAVES, 0.2, sides=7, rows=6)])


def conifer(rng: np.random.Generator) -> Mesh:
    """Build a trunk with four or five tiers of drooping branches, which get narrower upwards."""
    height, skirt = rng.uniform(6, 12), rng.uniform(1.6, 2.5)
    tiers = int(rng.integers(4, 6))
    parts = [lathe([0.2, 0.14], [-0.3, 1.6], 6, _BARK)]
    for k in range(tiers):
        low = 1.0 + (height - 1.5) * k / tiers
        wide = skirt * (1 - 0.8 * k / tiers)
        tip = min(low + 1.9 * (height - 1) / tiers, height)
        parts.append(lathe([0.25, wide, 0.45 * wide, 0], [low + 0.3, low, low + 0.35 * (tip - low), tip], 6, LEAVES))
    return concatenate(parts)


def birch(rng: np.random.Generator) -> Mesh:
    """Build a pale stem with a sparse light crown."""
    height = rng.uniform(6, 10)
    parts = [lathe([0.14, 0.1, 0.03], [-0.3, 0.4 * height, 0.95 * height], 6, _BIRCH)]
    for k in range(4):
        angle, size = 2.4 * k + rng.uniform(0, 1), rng.uniform(0.7, 1.15)
        center = _around(0.7, angle, max(height * (0.45 + 0.14 * k), 2.2 + 1.4 * size))
        parts.append(blob(rng, (size, size, 1.25 * size), center, LEAVES, 0.28, sides=6, rows=4))
    return concatenate(parts)


def young_tree(rng: np.random.Generator) -> Mesh:
    """Build a thin stem beside a stake with one small crown, as cities plant them along streets."""
    crown = rng.uniform(0.7, 1.1)
    height = rng.uniform(2.1, 2.6) + 2.3 * crown
    stake = lathe([0.04, 0.04, 0], [-0.2, 1.6, 1.6], 5, _BARK, (0.25, 0.0))
    stem = lathe([0.08, 0.06], [-0.3, height - crown], 6, _BARK)
    return concatenate([stem, stake, blob(rng, (crown, crown, 1.1 * crown), (0, 0, height - crown), LEAVES, 0.2)])


def bush(rng: np.random.Generator) -> Mesh:
    """Build two or three lumps on the ground."""
    parts = []
    for _ in range(int(rng.integers(2, 4))):
        size = rng.uniform(0.4, 0.8)
        center = (float(rng.uniform(-0.5, 0.5)), float(rng.uniform(-0.5, 0.5)), 0.55 * float(size))
        parts.append(blob(rng, (size, size, 0.9 * size), center, LEAVES, 0.25, sides=6, rows=4))
    return concatenate(parts)


def distant(rng: np.random.Generator) -> Mesh:
    """Build a tree of few triangles, for places far from every street."""
    height, crown, stem = rng.uniform(6, 11), rng.uniform(1.3, 2.2), rng.uniform(1.8, 3.0)
    trunk = lathe([0.2, 0.15], [-0.3, stem + 0.6], 4, _BARK)
    return concatenate([trunk, blob(rng, *_crown(height, crown, stem), LEAVES, 0.3, sides=6, rows=4)])


# the point at a distance and an angle around the stem; a docstring here would change `world_code`
def _around(radius_m: Number, angle_rad: Number, z_m: Number) -> Triple:
    return float(radius_m * np.cos(angle_rad)), float(radius_m * np.sin(angle_rad)), float(z_m)


def _crown(height_m: Number, radius_m: Number, stem_m: Number) -> tuple[Triple, Triple]:
    """Return the radii and the centre of an ellipsoid from the top of a bare stem up to the height of the tree."""
    return (radius_m, radius_m, (height_m - stem_m) / 2), (0, 0, (height_m + stem_m) / 2)


KINDS: dict[str, Callable[[np.random.Generator], Mesh]] = {
    "round": round_tree,
    "tall": tall_tree,
    "conifer": conifer,
    "birch": birch,
    "young": young_tree,
    "bush": bush,
    "distant": distant,
}
