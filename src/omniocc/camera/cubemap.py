"""Look rays up in the faces of a cube: how simulators that only render flat images give fisheye images."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Float32, Int64

MARGIN_PX = 1
"""Pixels beyond 90 degrees, so that pixels at a face's edge have neighbours to blend with."""
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
    """The places of P rays in the six faces of a cube, whose pixels are numbered face by face, row by row.

    Attributes:
        side: width and height of a face, px.
        inner: how many of them span 90 degrees.
        corner: the four pixels around each ray.
        weight: bilinear weights.
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
        """Return the pixels that any ray needs."""
        found = np.zeros((len(FACES), self.side, self.side), dtype=bool)
        found.reshape(-1)[self.corner] = True
        return found

    @property
    def faces(self) -> list[int]:
        """Return the faces that any ray needs."""
        return np.flatnonzero(self.needed.any(axis=(1, 2))).tolist()

    @property
    def field_deg(self) -> float:
        """Return the field of view of a whole face."""
        return float(np.degrees(2 * np.arctan(self.side / self.inner)))


def look_up_rays(rays: Float[np.ndarray, "3 P"], pixel_rad: float) -> CubeLookup:
    """Return the places of unit rays, given in the frame of the cube.

    Faces are as fine in their middle as pixels that are `pixel_rad` apart, finer elsewhere.
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
    lookup: CubeLookup, inverse: Float[np.ndarray, " Q"], even: Bool[np.ndarray, " P"]
) -> Float[np.ndarray, " P"]:
    """Return ranges along the rays, m, from inverse distances along the axes of the faces, 1/m; 0 gives infinity.

    Inverse distances are blended where the four pixels see one surface (`even`), which is exact on a plane; elsewhere
    the nearest pixel decides. `lookup` has numbers of the pixels in `inverse`.
    """
    blended = (inverse[lookup.corner] * lookup.weight).sum(axis=0)
    with np.errstate(divide="ignore"):
        return 1 / (np.where(even, blended, inverse[lookup.nearest]) * lookup.forward)
