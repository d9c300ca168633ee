"""Facade textures: storeys of windows over a ground floor with doors and shop windows, in four styles."""

from typing import NamedTuple

import numpy as np

from omniworld.assets.building import STOREY_M
from omniworld.render.texture.pattern import Tile, cells, fractal

_STOREYS = 4
_TILE_M = STOREY_M * _STOREYS


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
