"""Painters of the tiling textures, one per material."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from omniworld.mesh.material import Material


class Tile(NamedTuple):
    """A square tile of `size_m` metres: `tint` (N, N) multiplies the base colour, linear `added` (N, N, 3) is added."""

    size_m: float
    tint: np.ndarray
    added: np.ndarray


Painter = Callable[[np.random.Generator, int], Tile]


def value_noise(rng: np.random.Generator, size: int, rows: int, columns: int) -> np.ndarray:
    """Return (size, size) smooth tiling noise in [0, 1] from a lattice of rows x columns random values."""
    lattice = rng.random((rows, columns))
    result = lattice
    for axis, cells in ((0, rows), (1, columns)):
        position = (np.arange(size) + 0.5) * cells / size
        low = np.floor(position).astype(int)
        weight = position - low
        weight = weight * weight * (3 - 2 * weight)
        weight = weight[:, None] if axis == 0 else weight[None, :]
        first, second = np.take(result, low % cells, axis), np.take(result, (low + 1) % cells, axis)
        result = first * (1 - weight) + second * weight
    return result


def fractal(rng: np.random.Generator, size: int, cells: int, octaves: int, stretch: int = 1) -> np.ndarray:
    """Return (size, size) sum of noises in [0, 1], each octave twice as fine and half as strong.

    `stretch` is the factor by which it is longer along the rows' axis.
    """
    total, weight = np.zeros((size, size)), 0.0
    for octave in range(octaves):
        columns = min(cells << octave, size)
        total += value_noise(rng, size, max(columns // stretch, 1), columns) / (1 << octave)
        weight += 1 / (1 << octave)
    return total / weight


def cells(
    rng: np.random.Generator, size: int, rows: int, columns: int, shift: float, joint_px: float
) -> tuple[np.ndarray, np.ndarray]:
    """Lay out a wall of stones, every second row shifted.

    Returns:
        (size, size) random number of each stone, and whether a pixel is in a joint.
    """
    y = (np.arange(size) + 0.5)[:, None] * rows / size
    row = np.floor(y).astype(int) % rows
    x = (np.arange(size) + 0.5)[None, :] * columns / size + (row % 2) * shift
    column = np.floor(x).astype(int) % columns
    joint = ((y % 1) * size / rows < joint_px) | ((x % 1) * size / columns < joint_px)
    return rng.random((rows, columns))[row, column], joint


def _plain(size_m: float, tint: np.ndarray) -> Tile:
    return Tile(size_m, tint, np.zeros((*tint.shape, 3)))


def _grey(size_m: float, tint: np.ndarray, added: np.ndarray) -> Tile:
    return Tile(size_m, tint, np.repeat(added[..., None], 3, axis=-1))


def asphalt(rng: np.random.Generator, size: int) -> Tile:
    """Paint asphalt: grain, blotches, mended patches and cracks."""
    tint = 0.75 + 0.5 * fractal(rng, size, 4, 5) + 0.28 * (rng.random((size, size)) - 0.5)
    for _ in range(5):
        y, x = rng.integers(0, size, 2)
        height, width = rng.integers(size // 12, size // 4, 2)
        rows, columns = np.arange(y, y + height) % size, np.arange(x, x + width) % size
        tint[np.ix_(rows, columns)] *= rng.choice([0.72, 0.82, 1.18])
    crack = np.abs(fractal(rng, size, 3, 4) - 0.5)
    return _plain(8.0, tint * np.where(crack < 0.008, 0.55, 1.0))


def paint(rng: np.random.Generator, size: int) -> Tile:
    """Paint road paint worn through to the asphalt in places."""
    worn = fractal(rng, size, 12, 5) + 0.15 * (rng.random((size, size)) - 0.5)
    hole = np.clip((worn - 0.62) * 12, 0, 1)
    return _grey(4.0, (1.0 - hole) * (0.85 + 0.3 * (1 - worn)), 0.07 * hole)


def paving(rng: np.random.Generator, size: int) -> Tile:
    """Paint slabs of half a metre, of different brightness."""
    stone, joint = cells(rng, size, 8, 8, 0.5, 2.0)
    tint = 0.75 + 0.4 * stone + 0.25 * (fractal(rng, size, 8, 5) - 0.5) + 0.15 * (rng.random((size, size)) - 0.5)
    return _plain(4.0, np.where(joint, 0.5, tint))


def concrete(rng: np.random.Generator, size: int) -> Tile:
    """Paint cast panels with rain streaks."""
    panel, joint = cells(rng, size, 2, 2, 0.0, 2.0)
    streak = fractal(rng, size, 24, 3, stretch=12)
    tint = 0.75 + 0.2 * panel + 0.35 * (fractal(rng, size, 5, 6) - 0.5) + 0.3 * (streak - 0.5)
    tint += 0.08 * rng.random((size, size))
    return _plain(6.0, np.where(joint, 0.6, tint))


def grass(rng: np.random.Generator, size: int) -> Tile:
    """Paint grass: tufts, dry spots and blades."""
    tuft, dry = fractal(rng, size, 10, 5), np.clip(fractal(rng, size, 3, 4) * 3 - 1.5, 0, 1)
    tint = 0.35 + 0.9 * tuft + 0.7 * (rng.random((size, size)) - 0.5) * tuft
    added = dry[..., None] * np.array([0.10, 0.075, 0.02]) * tuft[..., None]
    return Tile(6.0, np.clip(tint, 0.1, None) * (1 - 0.4 * dry), added)


def soil(rng: np.random.Generator, size: int) -> Tile:
    """Paint earth with pebbles."""
    pebble = rng.random((size, size)) > 0.965
    tint = 0.5 + fractal(rng, size, 5, 6) + 0.25 * (rng.random((size, size)) - 0.5)
    return _grey(5.0, tint, np.where(pebble, 0.12, 0.0))


def brick(rng: np.random.Generator, size: int) -> Tile:
    """Paint courses of bricks with pale mortar."""
    stone, joint = cells(rng, size, 32, 10, 0.5, 1.2)
    tint = 0.6 + 0.6 * stone + 0.3 * (fractal(rng, size, 4, 5) - 0.5)
    return _grey(2.5, np.where(joint, 0.25, tint), np.where(joint, 0.16, 0.0))


def plaster(rng: np.random.Generator, size: int) -> Tile:
    """Paint plaster with stains that run downwards."""
    streak, blotch = fractal(rng, size, 20, 4, stretch=8), fractal(rng, size, 3, 6)
    tint = 0.72 + 0.3 * streak + 0.35 * (blotch - 0.3) + 0.1 * (rng.random((size, size)) - 0.5)
    return _plain(6.0, tint)


def glass(rng: np.random.Generator, size: int) -> Tile:
    """Paint dark panes, to which the shader adds the reflection."""
    shade = 0.02 + 0.05 * fractal(rng, size, 4, 3)
    return Tile(3.0, np.zeros((size, size)), shade[..., None] * np.array([0.8, 1.0, 1.1]))


def roof(rng: np.random.Generator, size: int) -> Tile:
    """Paint rows of tiles."""
    tile, joint = cells(rng, size, 16, 20, 0.5, 2.0)
    tint = 0.65 + 0.6 * tile + 0.4 * (fractal(rng, size, 3, 5) - 0.5)
    return _plain(5.0, np.where(joint, 0.45, tint))


def wood(rng: np.random.Generator, size: int) -> Tile:
    """Paint upright planks with grain."""
    plank, joint = cells(rng, size, 1, 16, 0.0, 1.6)
    tint = 0.6 + 0.5 * plank + 0.5 * (fractal(rng, size, 48, 3, stretch=16) - 0.5)
    return _plain(2.4, np.where(joint, 0.3, tint))


def bark(rng: np.random.Generator, size: int) -> Tile:
    """Paint upright ridges."""
    ridge = fractal(rng, size, 20, 4, stretch=5)
    return _plain(2.0, np.clip(2.2 * ridge - 0.2 + 0.2 * (rng.random((size, size)) - 0.5), 0.1, None))


def leaves(rng: np.random.Generator, size: int) -> Tile:
    """Paint clumps with deep gaps and sunlit tips."""
    clump, leaf = fractal(rng, size, 6, 4), value_noise(rng, size, 64, 64)
    tint = np.clip(2.6 * clump * (0.35 + leaf) - 0.25, 0.08, 1.9)
    added = (leaf > 0.8)[..., None] * (clump > 0.5)[..., None] * np.array([0.05, 0.06, 0.0])
    return Tile(4.0, tint, added)


def metal(rng: np.random.Generator, size: int) -> Tile:
    """Paint dull sheet with scuffs and a little rust."""
    rust = np.clip(fractal(rng, size, 6, 5) * 8 - 5, 0, 1)
    tint = (0.85 + 0.3 * fractal(rng, size, 16, 4, stretch=8)) * (1 - 0.6 * rust)
    return Tile(2.0, tint, rust[..., None] * np.array([0.10, 0.04, 0.015]))


def car_paint(rng: np.random.Generator, size: int) -> Tile:
    """Paint lacquer with a film of dust."""
    return _grey(3.0, 0.9 + 0.12 * fractal(rng, size, 4, 3), 0.02 * fractal(rng, size, 6, 4))


def cloth(rng: np.random.Generator, size: int) -> Tile:
    """Paint folds and stripes."""
    band = np.sin(np.arange(size) * 2 * np.pi * 6 / size)[:, None] > 0.75
    fold = fractal(rng, size, 6, 4, stretch=3)
    return _plain(0.9, (0.45 + 1.1 * fold) * np.where(band, 0.6, 1.0))


def sign(rng: np.random.Generator, size: int) -> Tile:
    """Paint a bright face with dark letters."""
    block, gap = cells(rng, size, 8, 12, 0.3, 6.0)
    letters = (block > 0.45) & ~gap
    return _grey(0.8, np.where(letters, 1.1, 0.25), np.where(letters, 0.0, 0.5))


def _noise(size_m: float, least: float, gain: float, cells: int, octaves: int) -> Painter:
    """Return the painter of a nearly even surface."""
    return lambda rng, size: _plain(size_m, least + gain * fractal(rng, size, cells, octaves))


PAINTERS: dict[Material, Painter] = {
    Material.ASPHALT: asphalt,
    Material.PAINT: paint,
    Material.PAVING: paving,
    Material.CONCRETE: concrete,
    Material.GRASS: grass,
    Material.SOIL: soil,
    Material.BRICK: brick,
    Material.PLASTER: plaster,
    Material.FACADE: plaster,
    Material.GLASS: glass,
    Material.ROOF: roof,
    Material.WOOD: wood,
    Material.BARK: bark,
    Material.LEAVES: leaves,
    Material.METAL: metal,
    Material.CAR_PAINT: car_paint,
    Material.RUBBER: _noise(0.6, 0.7, 0.6, 16, 3),
    Material.CLOTH: cloth,
    Material.SKIN: _noise(0.5, 0.85, 0.3, 4, 3),
    Material.SIGN: sign,
    Material.LAMP: _noise(0.5, 0.9, 0.2, 6, 2),
}
