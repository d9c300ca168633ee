"""The textures of all materials: tiles with mip levels, painted once per process, looked up by metres.

A texel holds a factor on the surface's base colour (`tint`, 0 to 2) and a colour that is added, so that one
brick pattern serves walls of any colour while its mortar stays grey and windows stay dark.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from omniworld.mesh.material import Material
from omniworld.render.texture import pattern
from omniworld.render.texture.facade import facade_layers

SIZE_PX = 256
LEVELS = SIZE_PX.bit_length()
LAYER_PX = sum((SIZE_PX >> level) ** 2 for level in range(LEVELS))
LEVEL_START = np.cumsum([0] + [(SIZE_PX >> level) ** 2 for level in range(LEVELS - 1)]).astype(np.int32)
MACRO_M = 53.0
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
