"""Feature maps of some cameras -> features on spheres, as one sparse matrix for each block of spheres.

The pixels of a point depend only on rig and sizes. Projection, bilinear sampling and the weighted sum over cameras are
linear in the features: one matrix in compressed rows does all three, and its transpose is the backward pass. On the CPU
this is several times faster than `grid_sample` for every camera, which also samples where a camera sees nothing.
"""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any, NamedTuple

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float, Float32, Float64, Int32, Int64
from scipy.sparse import csr_matrix
from torch import Tensor
from torch.autograd.function import once_differentiable
from torch.nn import functional as F

from omniocc.camera import Equirectangular, Rig
from omniocc.model.ops.depth.spheres import Spheres
from omniocc.model.ops.multilinear import bag_sum
from omniocc.model.ops.padded import frame_size
from omniocc.model.ops.rig_cache import once_per_rig
from omniocc.model.ops.static import is_static

TAPER = 0.08
"""Width of the band at the edge of a camera's field where its weight falls to zero, in image heights: without it the
mean over cameras would jump where one of them stops seeing."""
BLOCK_ROWS = 1 << 16
"""Rows of the sampling matrix of a block of spheres on a CPU, at most, unless a single sphere has more."""
FAR_M = 1e6
"""Range of the points on the sphere at infinity, whose inverse range is 0."""
LEAST_PRESENT = 0.05
"""Lower limit of the fraction of present cameras by which a point's features are divided: a smaller one would enlarge
what hardly any camera sees."""


class Present(NamedTuple):
    """Which cameras are there.

    Attributes:
        mask: of the cameras of each sample.
        complete: whether it is known that none is missing, which saves work.
    """

    mask: Bool[Tensor, "B N"]
    complete: bool

    @classmethod
    def of(cls, mask: Bool[Tensor, "B N"]) -> "Present":
        """Return the cameras of a mask, which is looked at once."""
        return cls(mask, not is_static() and bool(mask.all()))


@dataclass(frozen=True, eq=False)
class Sampler:
    """Sample features by a sparse matrix whose rows sum to 1, or to 0 where no camera sees; `transpose` is lazy.

    Attributes:
        matrix: (points, pixels of all cameras), compressed rows.
        first: index of each row's first entry.
        columns: of the entries.
        values: of the entries.
    """

    matrix: Tensor
    first: Int32[Tensor, " points"]
    columns: Int32[Tensor, " entries"]
    values: Float32[Tensor, " entries"]

    @cached_property
    def seen(self) -> Bool[Tensor, " points"]:
        """Return the mask of points that any camera sees."""
        return self.matrix.crow_indices().diff() > 0

    @cached_property
    def seen_fraction(self) -> Float[Tensor, "points 1"]:
        """Return 1 for points that any camera sees, else 0."""
        return self.seen[:, None].float()

    @cached_property
    def transpose(self) -> Tensor:
        """Return the transpose, (pixels of all cameras, points), compressed rows."""
        with warnings.catch_warnings(), torch.inference_mode(False):  # training may use it as well
            warnings.filterwarnings("ignore", message="Sparse CSR tensor support is in beta")
            swapped = self.matrix.to_sparse_csc()
            parts = swapped.ccol_indices().int(), swapped.row_indices().int(), swapped.values()
            return torch.sparse_csr_tensor(*parts, self.matrix.shape[::-1], check_invariants=False)

    def __call__(self, rows: Float[Tensor, "pixels BC"]) -> Float[Tensor, "points BC"]:
        """Return weighted means of rows, in float32; differentiable."""
        return _Sample.apply(rows, self)

    def present_fraction(self, present: Present) -> Float[Tensor, "points B"]:
        """Return the fraction of each point's weight that is in present cameras."""
        if present.complete:
            return self.seen_fraction.expand(-1, len(present.mask))
        pixels = present.mask.T.float().repeat_interleave(self.matrix.shape[1] // present.mask.shape[1], 0)
        return self.product(pixels)

    def mean(
        self, rows: Float[Tensor, "pixels BC"], present: Present
    ) -> tuple[Float[Tensor, "points B C"], Float[Tensor, "points B"]]:
        """Return the mean features over present cameras, and the fraction of each point's weight that is in these."""
        fraction = self.present_fraction(present)
        return self(rows).unflatten(1, (len(present.mask), -1)) / fraction.clamp(min=LEAST_PRESENT)[..., None], fraction

    def product(self, rows: Float[Tensor, "columns K"], less: Float[Tensor, "points K"] | None = None) -> Tensor:
        """Return `matrix @ rows`, or `less - matrix @ rows` in place."""
        if not is_static():
            return product(self.matrix, rows, less)
        # exported programs have no sparse matrices, and files of them no empty constants
        shape = len(self.first), rows.shape[1]
        sums = bag_sum(self.columns, rows, self.first, self.values) if len(self.columns) else rows.new_zeros(shape)
        return sums if less is None else less - sums


def product(
    matrix: Tensor, rows: Float[Tensor, "columns K"], less: Float[Tensor, "points K"] | None = None
) -> Float[Tensor, "points K"]:
    """Return sparse `matrix @ rows`, or `less - matrix @ rows` in place.

    Three times as fast on the CPU as the operator, which fills, copies and then adds its result.
    """
    if less is None:
        return torch.addmm(empty := rows.new_empty(matrix.shape[0], rows.shape[1]), matrix, rows, beta=0, out=empty)
    return torch.addmm(less, matrix, rows, alpha=-1, out=less)


class _Sample(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, rows: Tensor, sampler: Sampler) -> Tensor:
        ctx.sampler = sampler
        with torch.autocast(rows.device.type, enabled=False):
            return sampler.product(rows.float())

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor, None]:
        return product(ctx.sampler.transpose, grads[0].contiguous()), None


class _SquaredGap(torch.autograd.Function):
    """Sum squared differences over channels, with no other intermediate of the size of the swept features."""

    @staticmethod
    def forward(
        ctx: Any, rows: Tensor, one: Sampler, two: Sampler, scales: tuple[Tensor, Tensor] | None, pool: Tensor
    ) -> Tensor:
        ctx.samplers, ctx.scales = (one, two), scales
        rows, batch = rows.float(), len(pool)
        with torch.autocast(rows.device.type, enabled=False):
            if scales is None:
                gap = two.product(rows, less=one.product(rows)).unflatten(1, (-1, batch))
            else:
                sides = [sampler.product(rows).unflatten(1, (-1, batch)) for sampler in (one, two)]
                gap = sides[0].mul_(scales[0][..., None]).sub_(sides[1].mul_(scales[1][..., None]))
            ctx.save_for_backward(gap, pool)
            return gap.square().flatten(0, 1) @ pool

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor, None, None, None, None]:
        gap, pool = ctx.saved_tensors
        spread = (grads[0] @ (2 * pool).T).view_as(gap).mul_(gap)
        one, two = (sampler.transpose for sampler in ctx.samplers)
        sides = [spread, spread]
        if ctx.scales is not None:
            sides = [spread * scale[..., None] for scale in ctx.scales]
        return product(two, sides[1].flatten(1), less=product(one, sides[0].flatten(1))), None, None, None, None


def similarity(
    rows: Float[Tensor, "pixels BC"], one: Sampler, two: Sampler, present: Present, groups: int
) -> tuple[Float[Tensor, "points B G"], Float[Tensor, "points B"], Float[Tensor, "points B"]]:
    """Return the similarity of the features of two sets of cameras, and the fractions of the sets that are present.

    It is 1 / (1 + mean squared difference) in each group of channels, and 0 where one set sees nothing.
    Unlike a product it is greatest where both see the same, for any features, also before training. In float32.
    """
    samples = len(present.mask)
    pool = mean_of_groups(rows.shape[1] // samples, groups, rows.device)
    fractions = one.present_fraction(present), two.present_fraction(present)
    missing = None if present.complete else tuple(1 / part.clamp(min=LEAST_PRESENT) for part in fractions)
    gap = _SquaredGap.apply(rows, one, two, missing, pool).view(-1, samples, groups)
    both = torch.minimum(*fractions) > 0
    return both[..., None] / (1 + gap), *fractions


@lru_cache(maxsize=16)
def mean_of_groups(channels: int, groups: int, device: torch.device) -> Float[Tensor, "channels groups"]:
    """Return the matrix that takes channels to the means of groups of them."""
    with torch.inference_mode(False):  # training may use it as well
        return torch.eye(groups, device=device).repeat_interleave(channels // groups, 0) * (groups / channels)


@dataclass(frozen=True)
class Projection:
    """Parameters of a projection into the cameras of a rig.

    Attributes:
        panorama: directions of the swept points.
        spheres: their ranges.
        feature_size: width and height of the feature maps, px; they span the rig's largest image.
        cameras: indices of the cameras that are summed over.
        planes: indices of the spheres, which need not be whole numbers.
        divided: whether the cameras that see a point are divided, in the order of its angle from their axes: the first,
            third, ... and the second, fourth, ...
    """

    panorama: Equirectangular
    spheres: Spheres
    feature_size: tuple[int, int]
    cameras: tuple[int, ...]
    planes: tuple[float, ...]
    divided: bool = False


@once_per_rig
def field_weight(rig: Rig, camera: int) -> Float32[Tensor, "height width"]:
    """Return 1 inside a camera's field of view, falling linearly to 0 at its edge (image border, lens, mask)."""
    seen = rig.rays(camera)[1].numpy().astype(np.uint8)
    distance = cv2.distanceTransform(np.pad(seen, 1), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)[1:-1, 1:-1]
    return torch.from_numpy(np.clip((distance - 0.5) / (TAPER * seen.shape[0]), 0, 1)).float()


def _taps(
    rig: Rig, camera: int, pixels: Float[Tensor, "S 2"], width: int, height: int
) -> tuple[Int64[Tensor, "S 4"], Float64[Tensor, "S 4"]]:
    """Return columns and weights of the four neighbours of each pixel in one camera's feature map."""
    model = rig.cameras[camera]
    u, v = pixels.round().long().unbind(-1)
    weight = field_weight(rig, camera)[v.clamp(0, model.height - 1), u.clamp(0, model.width - 1)].double()
    frame_width, frame_height = frame_size(rig)
    columns, rows = -(-model.width * width // frame_width), -(-model.height * height // frame_height)
    x = ((pixels[:, 0] + 0.5) * width / frame_width - 0.5).clamp(0, columns - 1)
    y = ((pixels[:, 1] + 0.5) * height / frame_height - 0.5).clamp(0, rows - 1)
    # the right and lower neighbours are pixels of the map too, at its edge with weight 0
    left, top = x.floor().clamp(max=max(width - 2, 0)), y.floor().clamp(max=max(height - 2, 0))
    fx, fy = x - left, y - top
    corner = (camera * height + top.long()) * width + left.long()
    column = torch.stack([corner, corner + 1, corner + width, corner + width + 1], -1)
    tap = torch.stack([(1 - fx) * (1 - fy), fx * (1 - fy), (1 - fx) * fy, fx * fy], -1) * weight[:, None]
    return column, tap


Entries = tuple[Tensor, Tensor, Tensor]
"""Of a matrix: their rows, their columns, their values."""


def _entries(rig: Rig, projection: Projection, points_m: Float[Tensor, "P 3"]) -> list[Entries]:
    """Return the entries of points, of each of the two sets of cameras if these are divided for every point."""
    none = torch.empty(0, dtype=torch.long), torch.empty(0, dtype=torch.long), torch.empty(0)
    sides: list[list[Entries]] = [[none] for _ in range(1 + projection.divided)]
    projected = [rig.project_into(k, points_m) for k in projection.cameras]
    place = (
        _places(rig, projection.cameras, points_m, [valid for _, valid in projected]) if projection.divided else None
    )
    for order, (camera, (pixels, valid)) in enumerate(zip(projection.cameras, projected, strict=True)):
        seen = valid.nonzero()[:, 0]
        columns, values = _taps(rig, camera, pixels[seen], *projection.feature_size)
        kept = values > 1e-6  # where all that see a point have weight 0, its row would be divided by 0
        rows = seen[:, None].expand_as(columns)
        for number, side in enumerate(sides):
            own = kept if place is None else kept & (place[order, seen] % 2 == number)[:, None]
            side.append((rows[own], columns[own], values[own].float()))
    return [tuple(torch.cat(part) for part in zip(*side, strict=True)) for side in sides]  # type: ignore[misc]


def _places(
    rig: Rig, cameras: Sequence[int], points_m: Float[Tensor, "P 3"], valid: Sequence[Bool[Tensor, " P"]]
) -> Int64[Tensor, "N P"]:
    """Return each camera's place, from 0, in the order of angles between its axis and a point; blind ones are last."""
    poses = rig.ego_from_camera[list(cameras)]
    toward = F.normalize(points_m - poses[:, None, :3, 3], dim=-1)
    cosine = (toward * poses[:, None, :3, 2]).sum(-1)
    # -2 is below every cosine
    order = torch.argsort(cosine.where(torch.stack(list(valid)), -2), dim=0, descending=True, stable=True)
    return torch.argsort(order, dim=0)


def _sampler(entries: Entries, shape: tuple[int, int], device: torch.device) -> Sampler:
    """Return the matrix of these entries and shape, its rows divided by their sums."""
    rows, columns, values = entries
    values = values / torch.zeros(shape[0]).index_add_(0, rows, values)[rows]
    ordered = csr_matrix((values.numpy(), (rows.numpy(), columns.numpy())), shape)
    parts = (ordered.indptr.astype(np.int32), ordered.indices.astype(np.int32), ordered.data)
    crow, columns, values = (torch.from_numpy(part).to(device) for part in parts)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Sparse CSR tensor support is in beta")
        matrix = torch.sparse_csr_tensor(crow, columns, values, shape, check_invariants=False)
        return Sampler(matrix, crow[:-1].clone(), columns, values)  # columns and values share memory with the matrix


def samplers(rig: Rig, projection: Projection, device: torch.device) -> tuple[Sampler, ...]:
    """Return the matrices of a projection, on a CPU in blocks of about 64k rows, which stay in its cache."""
    return tuple(side[0] for side in _all_samplers(rig, projection, device))


def divided_samplers(rig: Rig, projection: Projection, device: torch.device) -> tuple[tuple[Sampler, Sampler], ...]:
    """Return the matrices of both sets of cameras, divided for every point, in blocks as `samplers` does."""
    return tuple((one, two) for one, two in _all_samplers(rig, replace(projection, divided=True), device))


@once_per_rig
def _all_samplers(rig: Rig, projection: Projection, device: torch.device) -> tuple[tuple[Sampler, ...], ...]:
    rays = projection.panorama.rays().double().reshape(-1, 3)
    size = len(projection.planes) if device.type == "cuda" else max(1, BLOCK_ROWS // len(rays))
    inverse_m = torch.tensor(projection.planes, dtype=torch.float64) * projection.spheres.step_per_m
    blocks = [(block[:, None, None] * rays).flatten(0, 1) for block in (1 / inverse_m).clamp(max=FAR_M).split(size)]
    width, height = projection.feature_size
    pixels = len(rig.cameras) * width * height
    return tuple(
        tuple(_sampler(side, (len(points_m), pixels), device) for side in _entries(rig, projection, points_m))
        for points_m in blocks
    )


def table(features: Float[Tensor, "B N C H W"], present: Present) -> Float[Tensor, "pixels BC"]:
    """Return one row per pixel of all cameras, the channels of all samples side by side; zeros where one is missing."""
    rows = features.permute(1, 3, 4, 0, 2)
    if not present.complete:
        rows = rows * present.mask.T[:, None, None, :, None]
    return rows.flatten(3).flatten(0, 2)


def present_cameras(images: Float[Tensor, "B N 3 H W"]) -> Bool[Tensor, "B N"]:
    """Return the cameras whose image is not black all over."""
    return images.flatten(2).amax(-1) > 0


@once_per_rig
def alternate_cameras(rig: Rig) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Return every other camera by the azimuth of its axis, and the rest: {0, 2, 4} and {1, 3, 5} in a hexagon."""
    forward = rig.ego_from_camera[:, :2, 2]
    order = torch.atan2(forward[:, 1], forward[:, 0]).argsort(stable=True).tolist()
    return tuple(sorted(order[0::2])), tuple(sorted(order[1::2]))
