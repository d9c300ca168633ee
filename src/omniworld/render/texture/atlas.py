"""The textures of all materials: tiles with mip levels, painted once per process, looked up by metres.

A texel holds a factor on the surface's base colour (`tint`, 0 to 2) and a colour that is added, so that one
brick pattern serves walls of any colour while its mortar stays grey and windows stay dark.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from omniworld.assets.building import STOREY_M
from omniworld.mesh.material import Material
from omniworld.render.texture import pattern
from omniworld.render.texture.pattern import Tile, cells, fractal

_STOREYS = 4
_TILE_M = STOREY_M * _STOREYS
SIZE_PX = 256
LEVELS = SIZE_PX.bit_length()
LAYER_PX = sum((SIZE_PX >> level) ** 2 for level in range(LEVELS))
LEVEL_START = np.cumsum([0] + [(SIZE_PX >> level) ** 2 for level in range(LEVELS - 1)]).astype(np.int32)
MACRO_M = 53.0
FACADE_STYLES = 4


class Style(NamedTuple):
    """Windows per tile along the wall, and the window's bounds as fractions of its bay: left, right, bottom, top."""

    bays: int
    window: tuple[float, float, float, float]
    bricks: bool
    bars: int


_STYLES = (
    Style(6, (0.28, 0.72, 0.30, 0.80), False, 2),
    Style(5, (0.30, 0.68, 0.28, 0.82), True, 2),
    Style(4, (0.06, 0.94, 0.32, 0.88), False, 4),
    Style(8, (0.22, 0.78, 0.22, 0.84), False, 1),
)


def facade_layers(style: int, rng: np.random.Generator, size: int) -> list[Tile]:
    """Paint upper storeys and ground floor; rows are height above the ground and start at a storey's floor."""
    facade = _STYLES[style]
    tint = _wall(facade, rng, size)
    upper = _glaze(tint, facade.bays, facade.window, facade.bars, rng)
    shops = _glaze(tint * 0.8, facade.bays // 2, (0.10, 0.90, 0.12, 0.78), 3, rng)
    return [upper, _doors(shops, facade.bays // 2, rng)]


def _wall(facade: Style, rng: np.random.Generator, size: int) -> np.ndarray:
    streak = fractal(rng, size, 32, 3, stretch=12)
    tint = 0.78 + 0.25 * streak + 0.3 * (fractal(rng, size, 4, 6) - 0.5) + 0.1 * (rng.random((size, size)) - 0.5)
    if facade.bricks:
        stone, joint = cells(rng, size, 128, 42, 0.5, 0.8)
        tint *= np.where(joint, 1.2, 0.75 + 0.4 * stone)
    storey = (np.arange(size) * _STOREYS / size) % 1
    tint[storey < 0.07] *= 1.15
    tint[(storey >= 0.07) & (storey < 0.09)] *= 0.6
    return tint


def _glaze(
    wall: np.ndarray, bays: int, window: tuple[float, float, float, float], bars: int, rng: np.random.Generator
) -> Tile:
    size = len(wall)
    left, right, bottom, top = window
    y = ((np.arange(size) + 0.5) * _STOREYS / size)[:, None]
    x = ((np.arange(size) + 0.5) * bays / size)[None, :]
    a, b = (x % 1 - left) / (right - left), (y % 1 - bottom) / (top - bottom)
    inside = (a > 0) & (a < 1) & (b > 0) & (b < 1)
    rim = (a > -0.12) & (a < 1.12) & (b > -0.1) & (b < 1.08) & ~inside
    sill = (a > -0.16) & (a < 1.16) & (b > -0.18) & (b <= -0.08)
    bar = inside & (((a * bars) % 1 < 0.07) | (np.abs(b - 0.66) < 0.025))
    cell = (np.floor(y).astype(int), np.floor(x).astype(int))
    shade, kind, curtain = (rng.random((_STOREYS, bays))[cell] for _ in range(3))
    drawn = inside & (b > curtain) & (kind > 0.45)
    added = np.zeros((size, size, 3))
    added[inside] = ((0.012 + 0.05 * shade * (0.4 + b))[..., None] * np.array([0.8, 1.0, 1.15]))[inside]
    added[drawn] = ((0.12 + 0.25 * shade)[..., None] * np.array([1.0, 0.93, 0.8]))[drawn]
    added[bar] = 0.35
    tint = np.where(inside, 0.0, wall * np.where(rim, 1.25, 1.0) * np.where(sill, 0.55, 1.0))
    return Tile(_TILE_M, tint, added)


def _doors(ground: Tile, bays: int, rng: np.random.Generator) -> Tile:
    size = len(ground.tint)
    y = ((np.arange(size) + 0.5) * _TILE_M / size % STOREY_M)[:, None]
    x = ((np.arange(size) + 0.5) * bays / size)[None, :]
    bay = np.floor(x).astype(int)
    has_door = (rng.random(bays) < 0.5)[bay]
    aside = np.abs(x % 1 - 0.5)
    frame = has_door & (aside < 0.20) & (y < 2.35)
    door = has_door & (aside < 0.16) & (y < 2.2)
    panel = 0.7 + 0.5 * ((y % 0.7 > 0.12) & (aside < 0.12))
    color = rng.uniform(0.03, 0.25, (bays, 3))[np.broadcast_to(bay, door.shape)] * panel[..., None]
    tint, added = ground.tint.copy(), ground.added.copy()
    tint[frame], added[frame] = 1.2, 0.0
    tint[door], added[door] = 0.0, color[door]
    return Tile(ground.size_m, tint, added)


class Atlas(NamedTuple):
    """All textures.

    Attributes:
        texels: (layers * texels of a layer,) uint32: bytes 128 * tint, then 255 * square root of linear red, green
            and blue.
        texel_m: (layers,) float32, size of a texel of the finest level.
        macro: (SIZE_PX**2,) float32, slow brightness variation that hides the tiling, mean 1.
    """

    texels: np.ndarray
    texel_m: np.ndarray
    macro: np.ndarray


def layer_of(material: np.ndarray, color: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the texture layer of each face, and the step to that of the ground floor, as two (F,) int32.

    `material` is (F,) uint8, `color` (F, 3) uint8; facades of equal colour have one style, so that a building's walls
    match.
    """
    facade = material == Material.FACADE
    digest = color.astype(np.uint32) @ np.array([73, 179, 283], np.uint32)
    style = (digest // 7) % FACADE_STYLES
    layer = np.where(facade, len(Material) + 2 * style, material).astype(np.int32)
    return layer, facade.astype(np.int32)


@lru_cache(maxsize=1)
def make_atlas() -> Atlas:
    """Paint every material, which takes about half a second; kept for the process."""
    layers = [pattern.PAINTERS[material](np.random.default_rng([7, material]), SIZE_PX) for material in Material]
    for style in range(FACADE_STYLES):
        layers += facade_layers(style, np.random.default_rng([11, style]), SIZE_PX)
    texels = np.concatenate([_with_mips(tile.tint, tile.added) for tile in layers])
    texel_m = np.array([tile.size_m / SIZE_PX for tile in layers], np.float32)
    noise = pattern.fractal(np.random.default_rng(13), SIZE_PX, cells=5, octaves=5)
    return Atlas(texels, texel_m, (1.0 + 0.5 * (noise - noise.mean())).astype(np.float32).ravel())


def _with_mips(tint: np.ndarray, added: np.ndarray) -> np.ndarray:
    level = np.concatenate([tint[..., None], added], axis=-1)
    levels = []
    for _ in range(LEVELS):
        encoded = np.empty(level.shape, np.uint8)
        encoded[..., 0] = np.clip(np.rint(level[..., 0] * 128), 0, 255)
        encoded[..., 1:] = np.clip(np.rint(np.sqrt(np.clip(level[..., 1:], 0, 1)) * 255), 0, 255)
        levels.append(np.ascontiguousarray(encoded).view(np.uint32).ravel())
        if len(level) > 1:
            level = level.reshape(len(level) // 2, 2, len(level) // 2, 2, 4).mean(axis=(1, 3))
    return np.concatenate(levels)
