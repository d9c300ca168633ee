"""The textures of all materials: tiles with mip levels, painted once per process, looked up by metres.

A texel holds a factor on the surface's base colour (`tint`, 0 to 2) and a colour that is added, so that one
brick pattern serves walls of any colour while its mortar stays grey and windows stay dark.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from omniocc.world.assets.building import STOREY_M
from omniocc.world.mesh.material import Material
from omniocc.world.render.texture import pattern
from omniocc.world.render.texture.facade import facade_layers

SIZE_PX = 256
_LEVELS = SIZE_PX.bit_length()
_LAYER_PX = sum((SIZE_PX >> level) ** 2 for level in range(_LEVELS))
_LEVEL_START = np.cumsum([0] + [(SIZE_PX >> level) ** 2 for level in range(_LEVELS - 1)]).astype(np.int32)
_MACRO_M = 53.0
FACADE_STYLES = 4


class Atlas(NamedTuple):
    """All textures.

    Attributes:
        texels: (layers * texels of a layer,) uint32: bytes tint / 128, then red, green and blue as square roots of
            linear light.
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


def sample(
    layer: np.ndarray, ground_step: np.ndarray, u_m: np.ndarray, v_m: np.ndarray, footprint_m: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the textures' tint (R,) float32, with the slow variation, and added linear colour (3, R) float32.

    Args:
        layer: (R,) int32 from `layer_of`.
        ground_step: (R,) int32 from `layer_of`.
        u_m: (R,) float32 along the surface.
        v_m: (R,) float32 along the surface; upwards from the ground on facades.
        footprint_m: (R,) float32 width of the pixel on the surface, which selects the mip level.
    """
    atlas = make_atlas()
    layer = layer + ground_step * (v_m < STOREY_M)
    texel_m = atlas.texel_m[layer]
    level = np.log2(np.maximum(footprint_m / texel_m, 1.0)).astype(np.int32)
    np.minimum(level, _LEVELS - 1, out=level)
    column = np.floor(u_m / texel_m).astype(np.int32) & (SIZE_PX - 1)
    row = np.floor(v_m / texel_m).astype(np.int32) & (SIZE_PX - 1)
    index = layer * _LAYER_PX + _LEVEL_START[level] + ((row >> level) * (SIZE_PX >> level)) + (column >> level)
    texel = atlas.texels.take(index).view(np.uint8).reshape(-1, 4)
    scale = np.float32(SIZE_PX / _MACRO_M)
    macro_row = np.floor(v_m * scale).astype(np.int32) & (SIZE_PX - 1)
    macro_column = np.floor(u_m * scale).astype(np.int32) & (SIZE_PX - 1)
    tint = _TINT.take(texel[:, 0]) * atlas.macro.take(macro_row * SIZE_PX + macro_column)
    return tint, np.stack([_OWN.take(texel[:, channel]) for channel in (1, 2, 3)])


_TINT = (np.arange(256) / 128).astype(np.float32)
_OWN = ((np.arange(256) / 255) ** 2).astype(np.float32)


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
    for _ in range(_LEVELS):
        encoded = np.empty(level.shape, np.uint8)
        encoded[..., 0] = np.clip(np.rint(level[..., 0] * 128), 0, 255)
        encoded[..., 1:] = np.clip(np.rint(np.sqrt(np.clip(level[..., 1:], 0, 1)) * 255), 0, 255)
        levels.append(np.ascontiguousarray(encoded).view(np.uint32).ravel())
        if len(level) > 1:
            level = level.reshape(len(level) // 2, 2, len(level) // 2, 2, 4).mean(axis=(1, 3))
    return np.concatenate(levels)
