"""Street furniture and loose things (class Other); fronts face +y, the street."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from omniocc.seeding import choice
from omniworld.mesh.label import OTHER
from omniworld.mesh.material import Material
from omniworld.mesh.mesh import Mesh, concatenate
from omniworld.mesh.shape import Color, Skin, box, lathe

_COLORS: tuple[Color, ...] = ((46, 92, 64), (60, 66, 74), (168, 52, 44), (38, 78, 134), (196, 150, 48), (120, 120, 124))


def _skin(rng: np.random.Generator, material: Material) -> Skin:
    return Skin(OTHER, material, choice(rng, _COLORS))


_STEEL = Skin(OTHER, Material.METAL, (98, 102, 106))
_WOOD = Skin(OTHER, Material.WOOD, (150, 112, 74))


def bench(rng: np.random.Generator) -> Mesh:
    """Build a bench: seat, back and two legs."""
    length = float(rng.uniform(1.4, 2.0))
    legs = [box((0.08, 0.42, 0.46), (x, 0, 0.21), _STEEL) for x in (-0.4 * length, 0.4 * length)]
    slats = [box((length, 0.11, 0.04), (0, y, 0.45), _WOOD) for y in (-0.15, 0.0, 0.15)]
    back = [box((length, 0.04, 0.12), (0, -0.24, z), _WOOD) for z in (0.62, 0.8)]
    return concatenate([*legs, *slats, *back])


def bin_(rng: np.random.Generator) -> Mesh:
    """Build a litter bin or a wheeled bin."""
    skin = _skin(rng, Material.METAL)
    if rng.uniform() < 0.5:
        return lathe([0.22, 0.26, 0.27, 0.2, 0], [-0.05, 0.85, 0.92, 1.0, 1.02], 9, skin)
    lid = Skin(OTHER, Material.RUBBER, (60, 62, 64))
    return concatenate([box((0.56, 0.62, 1.0), (0, 0, 0.5), skin), box((0.6, 0.68, 0.08), (0, 0, 1.04), lid)])


def hydrant(rng: np.random.Generator) -> Mesh:
    """Build a fire hydrant."""
    skin = Skin(OTHER, Material.METAL, (188, 44, 36) if rng.uniform() < 0.7 else (214, 176, 44))
    body = lathe([0.17, 0.17, 0.12, 0.12, 0.16, 0.12, 0], [-0.05, 0.08, 0.1, 0.55, 0.58, 0.7, 0.78], 6, skin)
    return concatenate([body, box((0.4, 0.12, 0.12), (0, 0, 0.45), skin)])


def shelter(rng: np.random.Generator) -> Mesh:
    """Build a bus shelter: roof, glass back, one end with a poster and one of glass, a seat."""
    length = float(rng.uniform(2.8, 4.0))
    glass = Skin(OTHER, Material.GLASS, (126, 148, 156))
    posts = [box((0.08, 0.08, 2.4), (x, y, 1.2), _STEEL) for x in (-length / 2, length / 2) for y in (-0.6, 0.5)]
    back = box((length - 0.1, 0.03, 1.8), (0, -0.6, 1.15), glass)
    end = box((0.03, 0.95, 1.8), (-length / 2, -0.05, 1.15), glass)
    seat = box((length * 0.7, 0.35, 0.06), (0, -0.35, 0.48), _WOOD)
    poster = box((0.12, 0.9, 1.6), (length / 2, -0.05, 1.2), _skin(rng, Material.SIGN))
    return concatenate([*posts, back, end, seat, poster, box((length + 0.4, 1.5, 0.1), (0, 0, 2.45), _STEEL)])


def kiosk(rng: np.random.Generator) -> Mesh:
    """Build a newspaper stand with an awning."""
    body, band = _skin(rng, Material.PLASTER), _skin(rng, Material.SIGN)
    walls, roof = box((2.4, 1.6, 2.5), (0, 0, 1.2), body), box((2.6, 1.8, 0.25), (0, 0, 2.55), band)
    window = box((1.8, 0.04, 1.0), (0, 0.81, 1.5), Skin(OTHER, Material.GLASS, (90, 104, 112)))
    return concatenate([walls, window, roof, box((2.2, 0.5, 0.06), (0, 1.05, 2.3), band)])


def cabinet(rng: np.random.Generator) -> Mesh:
    """Build a switch cabinet, a mail box or a parking meter."""
    kind = int(rng.integers(3))
    if kind == 0:
        width, height = float(rng.uniform(0.7, 1.3)), float(rng.uniform(1.0, 1.4))
        return box((width, 0.4, height), (0, 0, height / 2), Skin(OTHER, Material.METAL, (142, 148, 140)))
    if kind == 1:
        skin = _skin(rng, Material.METAL)
        return concatenate([box((0.5, 0.42, 0.75), (0, 0, 0.95), skin), box((0.34, 0.3, 0.65), (0, 0, 0.28), _STEEL)])
    meter = box((0.26, 0.2, 0.4), (0, 0, 1.25), _skin(rng, Material.METAL))
    return concatenate([lathe([0.05, 0.05], [-0.1, 1.1], 6, _STEEL), meter])


def bollards(rng: np.random.Generator) -> Mesh:
    """Build a row of three bollards."""
    skin = _skin(rng, Material.METAL)
    return concatenate(lathe([0.09, 0.09, 0.06, 0], [-0.1, 0.8, 0.88, 0.92], 5, skin, (x, 0)) for x in (-1.2, 0.0, 1.2))


def planter(rng: np.random.Generator) -> Mesh:
    """Build a stone tub filled with soil."""
    size = float(rng.uniform(0.9, 1.4))
    tub = Skin(OTHER, Material.CONCRETE, (150, 146, 138))
    return box((size, 0.7, 0.6), (0, 0, 0.28), tub, Skin(OTHER, Material.SOIL, (84, 66, 48)))


def crates(rng: np.random.Generator) -> Mesh:
    """Build a few stacked boxes."""
    parts = []
    for k in range(int(rng.integers(2, 5))):
        size = (float(rng.uniform(0.5, 0.9)), float(rng.uniform(0.5, 0.8)), float(rng.uniform(0.4, 0.8)))
        low = 0.0 if k < 2 else 0.6
        skin = _WOOD if rng.uniform() < 0.6 else _skin(rng, Material.METAL)
        parts.append(box(size, (0.85 * (k % 2) - 0.4, float(rng.uniform(-0.15, 0.15)), low + size[2] / 2), skin))
    return concatenate(parts)


def pallets(rng: np.random.Generator) -> Mesh:
    """Build a stack of pallets, sometimes with a load."""
    count = int(rng.integers(3, 8))
    parts = [box((1.2, 0.8, 0.11), (0, 0, 0.07 + 0.145 * k), _WOOD) for k in range(count)]
    if rng.uniform() < 0.5:
        parts.append(box((1.1, 0.75, 0.8), (0, 0, 0.145 * count + 0.4), _skin(rng, Material.CLOTH)))
    return concatenate(parts)


def bales(rng: np.random.Generator) -> Mesh:
    """Build one or two hay bales."""
    hay = Skin(OTHER, Material.CLOTH, (190, 162, 92))
    parts = [box((1.1, 0.8, 0.7), (0.0, 0, 0.34), hay), box((1.0, 0.8, 0.7), (0.1, 0.05, 1.02), hay)]
    return concatenate(parts[: int(rng.integers(1, 3))])


def post_box(rng: np.random.Generator) -> Mesh:
    """Build a letter box on a post."""
    letters = box((0.24, 0.5, 0.26), (0, 0.05, 1.15), _skin(rng, Material.METAL))
    return concatenate([box((0.1, 0.1, 1.1), (0, 0, 0.5), _WOOD), letters])


class Kind(NamedTuple):
    """Builder of a prop, and the land that it needs (along the street, across)."""

    make: Callable[[np.random.Generator], Mesh]
    size_m: tuple[float, float]


KINDS: dict[str, Kind] = {
    "bench": Kind(bench, (2.0, 0.7)),
    "bin": Kind(bin_, (0.7, 0.7)),
    "hydrant": Kind(hydrant, (0.5, 0.5)),
    "shelter": Kind(shelter, (4.4, 1.5)),
    "kiosk": Kind(kiosk, (2.8, 2.0)),
    "box": Kind(cabinet, (1.4, 0.6)),
    "bollards": Kind(bollards, (2.8, 0.4)),
    "planter": Kind(planter, (1.5, 0.8)),
    "crates": Kind(crates, (1.9, 0.9)),
    "pallets": Kind(pallets, (1.3, 0.9)),
    "bales": Kind(bales, (1.3, 1.0)),
    "post": Kind(post_box, (0.4, 0.6)),
}
