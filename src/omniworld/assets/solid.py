"""Plain solids of any material, which are nothing in particular: only their shape tells how far away they are."""

from collections.abc import Callable
from math import pi

import numpy as np

from omniworld.mesh.label import OTHER
from omniworld.mesh.material import Material
from omniworld.mesh.mesh import Mesh, transform
from omniworld.mesh.shape import Color, Skin, blob, box, lathe

_DULL = (Material.GLASS, Material.LAMP)  # no texture


def random_material(rng: np.random.Generator) -> Material:
    """Return a material with a texture."""
    return Material(int(rng.choice([material for material in Material if material not in _DULL])))


def random_color(rng: np.random.Generator) -> Color:
    """Return any colour but the darkest."""
    red, green, blue = rng.integers(30, 250, 3).tolist()
    return red, green, blue


def _skin(rng: np.random.Generator) -> Skin:
    return Skin(OTHER, random_material(rng), random_color(rng))


def _tilted(rng: np.random.Generator, mesh: Mesh) -> Mesh:
    """Return the solid turned any way up, its middle at the origin."""
    turn = np.eye(4)
    turn[:3, :3] = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    turn[:3, 0] *= np.sign(np.linalg.det(turn[:3, :3]))
    return transform(mesh, turn)


def block(rng: np.random.Generator) -> Mesh:
    """Build a cuboid."""
    size = np.exp(rng.uniform(np.log(0.3), np.log(3.0), 3)).tolist()
    return _tilted(rng, box((size[0], size[1], size[2]), (0.0, 0.0, 0.0), _skin(rng), _skin(rng)))


def slab(rng: np.random.Generator) -> Mesh:
    """Build a standing wall."""
    width, height = rng.uniform((1.5, 1.0), (7.0, 5.0)).tolist()
    return box((width, 0.2, height), (0.0, 0.0, height / 2), _skin(rng))


def ball(rng: np.random.Generator) -> Mesh:
    """Build a smooth or lumpy ellipsoid."""
    radius = np.exp(rng.uniform(np.log(0.2), np.log(1.8), 3)).tolist()
    size = (radius[0], radius[1], radius[2])
    return _tilted(rng, blob(rng, size, (0.0, 0.0, 0.0), _skin(rng), float(rng.uniform(0, 0.3)), 11, rows=8))


def turned(rng: np.random.Generator) -> Mesh:
    """Build a vase: a profile of any width turned around an axis."""
    height = float(rng.uniform(0.5, 4.0))
    radius = [0.0, *rng.uniform(0.1, 1.0, 5).tolist(), 0.0]
    return lathe(radius, np.linspace(0, height, len(radius)).tolist(), 12, _skin(rng))


def bar(rng: np.random.Generator) -> Mesh:
    """Build a thin pole, upright or leaning."""
    length, lean = float(rng.uniform(1.5, 7.0)), float(rng.normal(0, 0.3))
    mesh = lathe([0.06, 0.06, 0.0], [0.0, length, length + 0.01], 6, _skin(rng))
    turn = np.eye(4)
    turn[:3, :3] = [[np.cos(lean), 0, np.sin(lean)], [0, 1, 0], [-np.sin(lean), 0, np.cos(lean)]]
    return transform(mesh, turn) if abs(lean) < pi / 3 else mesh


KINDS: dict[str, Callable[[np.random.Generator], Mesh]] = {
    "block": block,
    "slab": slab,
    "ball": ball,
    "turned": turned,
    "bar": bar,
}
