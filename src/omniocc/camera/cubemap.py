"""Look up rays in the faces of a cube, so that renderers of pinhole images can give fisheye images."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Float32, Int64

MARGIN_PX = 1
"""Pixels beyond 90 degrees on each side, so that rays at a face's edge lie between four pixels."""
FACES = np.array(
    [
        [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
        [[0, 0, 1], [0, 1, 0], [-1, 0, 0]],
        [[0, 0, -1], [0, 1, 0], [1, 0, 0]],
        [[1, 0, 0], [0, 0, 1], [0, -1, 0]],
        [[1, 0, 0], [0, 0, -1], [0, 1, 0]],
        [[-1, 0, 0], [0, 1, 0], [0, 0, -1]],
    ],
    dtype=np.float64,
)
"""Columns: a face's right, down and forward in the frame of the cube (x right, y down, z forward); front, right, left,
down, up, back."""


@dataclass(frozen=True)
class CubeLookup:
    """The positions of P rays in the six faces of a cube, whose pixels are numbered face by face, row by row.

    Attributes:
        side: width and height of a face, px, with margins.
        inner: width and height of the part that spans 90 degrees, px.
        corner: the four pixels around each ray.
        weight: bilinear weight of each of the four.
        nearest: the closest pixel.
        forward: component of each unit ray along the axis of its face.
    """

    side: int
    inner: int
    corner: Int64[np.ndarray, "4 P"]
    weight: Float32[np.ndarray, "4 P"]
    nearest: Int64[np.ndarray, " P"]
    forward: Float32[np.ndarray, " P"]

    @property
    def needed(self) -> Bool[np.ndarray, "6 side side"]:
        """Return which pixels are needed by any ray."""
        found = np.zeros((len(FACES), self.side, self.side), dtype=bool)
        found.reshape(-1)[self.corner] = True
        return found

    @property
    def faces(self) -> list[int]:
        """Return the numbers of the faces that are needed by any ray."""
        return np.flatnonzero(self.needed.any(axis=(1, 2))).tolist()

    @property
    def field_deg(self) -> float:
        """Return the field of view of a face with its margins."""
        return float(np.degrees(2 * np.arctan(self.side / self.inner)))


def look_up_rays(rays: Float[np.ndarray, "3 P"], pixel_rad: float) -> CubeLookup:
    """Return the positions of unit rays, given in the frame of the cube.

    The pixels in the middle of a face are at most `pixel_rad` apart, the others less.
    """
    inner = int(np.ceil(2 / pixel_rad))
    side = inner + 2 * MARGIN_PX
    along = np.einsum("fij,ip->fjp", FACES, rays.astype(np.float64))
    face = along[:, 2].argmax(axis=0)
    x, y, z = np.moveaxis(along[face, :, np.arange(len(face))], -1, 0)
    column, row = ((part / z + 1) * inner / 2 - 0.5 + MARGIN_PX for part in (x, y))
    left, top = np.floor(column).astype(np.int64), np.floor(row).astype(np.int64)
    right, lower = column - left, row - top
    corner = np.stack([(face * side + top + a) * side + left + b for a in (0, 1) for b in (0, 1)])
    weight = np.stack([(lower if a else 1 - lower) * (right if b else 1 - right) for a in (0, 1) for b in (0, 1)])
    nearest = corner[weight.argmax(axis=0), np.arange(len(face))]
    return CubeLookup(side, inner, corner, weight.astype(np.float32), nearest, z.astype(np.float32))


def blend_ranges(
    lookup: CubeLookup, inverse_depth: Float[np.ndarray, " Q"], one_surface: Bool[np.ndarray, " P"]
) -> Float[np.ndarray, " P"]:
    """Return ranges along the rays, m, from the inverse depths of all pixels, 1/m; an inverse depth of 0 gives inf.

    Depth is the distance along the axis of a face. Inverse depths are blended where the four pixels see `one_surface`,
    which is exact on a plane; elsewhere the nearest pixel decides. `inverse_depth` is indexed by the pixel numbers of
    `lookup`.
    """
    blended = (inverse_depth[lookup.corner] * lookup.weight).sum(axis=0)
    with np.errstate(divide="ignore"):
        return 1 / (np.where(one_surface, blended, inverse_depth[lookup.nearest]) * lookup.forward)
