"""Whether images fit together where neighbouring cameras see the same, and whether they would in another order."""

from collections.abc import Hashable, Mapping, Sequence
from itertools import combinations, permutations
from typing import NamedTuple

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float32, UInt8
from torch import Tensor
from torch.nn.functional import grid_sample

from omniocc.camera.models.equirectangular import Equirectangular
from omniocc.camera.ops.pixels import normalize_pixels
from omniocc.camera.rig import Rig

DIRECTIONS = Equirectangular(240, 80, 45.0, -75.0)
"""Directions around the ego origin in which images are compared, 1.5 degrees apart."""
RANGES_M = (2.0, 4.0, 8.0, 16.0, 64.0)
"""Ranges at which a thing may lie."""
SIZE_PX = (192, 144)
"""Width and height to which images are reduced: about as many pixels to a degree as `DIRECTIONS`."""
BLOCK_PX = 8
"""Edge of the square blocks of directions that are compared."""
NOISE = 0.01
"""Standard deviation of a block's values, in [0, 1], at which its correlation with itself is 0.5; below, it is less."""
LEAST_BLOCKS = 10
"""Fewest blocks that two cameras both see, for which their images are compared."""
MOST_CAMERAS = 8
"""Most cameras of which the orders are compared: there are 40,320 of eight."""
EVIDENCE = 0.8
"""Least gain in mean correlation, times the square root of the number of blocks.

Other orders than the correct one reach 0.54 by chance (60 virtual scenes)."""
ALIKE = 0.8
"""Fraction of the best order's gain from which another order counts as equally good."""

Images = Sequence[UInt8[np.ndarray, "_ _ 3"]]


class Seams(NamedTuple):
    """How well images fit where two cameras see the same.

    Attributes:
        blocks: number of blocks that both cameras see.
        fits: mean correlation of the blocks, in [-1, 1]. Element (i, j): the first camera has image i, the second
            image j.
    """

    blocks: int
    fits: Float32[np.ndarray, "N N"]


def better_order(images: Images, rig: Rig) -> tuple[int, ...] | None:
    """Return the number of the image that each camera should have; None if the given order fits, or it is not clear.

    Images change places only where their sizes are equal.
    """
    if len(images) > MOST_CAMERAS:
        return None
    return best_order(measure_seams(images, rig), [image.shape for image in images])


def best_order(seams: Mapping[tuple[int, int], Seams], kinds: Sequence[Hashable]) -> tuple[int, ...] | None:
    """Return the image of each camera by the measured seams; None as `better_order`. Images of one kind change places.

    Of orders that fit equally well, as in a ring of equal cameras whose images all move on by one, the one with the
    fewest changes is returned.
    """
    if not seams:
        return None
    orders = np.array([order for order in permutations(range(len(kinds))) if [kinds[k] for k in order] == list(kinds)])
    total, fits = sum(seam.blocks for seam in seams.values()), np.zeros(len(orders))
    for (one, other), seam in seams.items():
        fits += seam.blocks / total * seam.fits[orders[:, one], orders[:, other]]
    gains = fits - fits[0]  # the first order is the given one
    if gains.max() * total**0.5 < EVIDENCE:
        return None
    alike = np.flatnonzero(gains > ALIKE * gains.max())
    changes = (orders[alike] != orders[0]).sum(1)
    return tuple(map(int, orders[alike[np.lexsort((-gains[alike], changes))[0]]]))


def measure_seams(images: Images, rig: Rig) -> dict[tuple[int, int], Seams]:
    """Return how well each two images fit, for each pair of cameras that both see enough of the same.

    Each block is compared at all of `RANGES_M`, and the highest correlation counts.
    """
    points = torch.tensor(RANGES_M)[:, None, None, None] * DIRECTIONS.rays()
    reduced = [cv2.resize(image, SIZE_PX, interpolation=cv2.INTER_AREA) for image in images]
    pixels = torch.from_numpy(np.stack(reduced)).permute(0, 3, 1, 2).float() / 255
    views = [_blocks(pixels, rig, camera, points) for camera in range(len(images))]
    found = {}
    for (one, (left, seen)), (other, (right, seen_too)) in combinations(enumerate(views), 2):
        both = seen & seen_too
        blocks = both.any(0)
        if (count := int(blocks.sum())) >= LEAST_BLOCKS:
            alike = torch.einsum("isbk,jsbk->ijsb", left[:, :, blocks], right[:, :, blocks])
            fits = alike.where(both[:, blocks], -1.0).amax(2).mean(-1)
            found[one, other] = Seams(count, fits.numpy())
    return found


def _blocks(
    pixels: Float32[Tensor, "N 3 h w"], rig: Rig, camera: int, points: Float32[Tensor, "S rows columns 3"]
) -> tuple[Float32[Tensor, "N S B K"], Bool[Tensor, "S B"]]:
    """Return the blocks that one camera sees if it has each image, with mean 0 and length 1, and which it sees whole.

    S are the ranges, B the blocks, K the values of a block. Blocks with little texture are shorter, see `NOISE`.
    """
    places, seen = rig.project_into(camera, points)
    grid = normalize_pixels(places, rig.cameras[camera].width, rig.cameras[camera].height)
    grid = grid.reshape(1, -1, *grid.shape[2:]).expand(len(pixels), -1, -1, -1)
    values = grid_sample(pixels, grid, align_corners=False).reshape(len(pixels), 3, *seen.shape)
    blocks = _tiled(values).permute(0, 2, 3, 1, 4)
    blocks = (blocks - blocks.mean(-1, keepdim=True)).flatten(3)
    energy = blocks.square().sum(-1, keepdim=True) + blocks.shape[-1] * NOISE**2
    return blocks / energy.sqrt(), _tiled(seen).all(-1)


def _tiled(values: Tensor) -> Tensor:
    """Return square blocks (..., B, P) of maps (..., rows, columns)."""
    return values.unfold(-2, BLOCK_PX, BLOCK_PX).unfold(-2, BLOCK_PX, BLOCK_PX).flatten(-2).flatten(-3, -2)
