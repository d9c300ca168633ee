"""Loss of measured rays: free before the hit, occupied at it, unknown behind it."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float, Float32, Int64, UInt8
from torch import Tensor, nn

from omniocc.bounds import Count, Number, Weight
from omniocc.classes import FREE, UNKNOWN
from omniocc.geometry import Grid
from rayiou.raycast.trace import clip

MARGIN_CELLS = 0.5
"""Length before a hit that counts neither as free nor as occupied, in cells on the way to the z axis."""


class Rays(NamedTuple):
    """Measured rays in the ego frame of the scored frame.

    Attributes:
        origins_m: where they start, m; nan where a sample has fewer.
        ends_m: where they end, m.
        labels: class that is hit; 0: nothing was hit before the end, 255: something of unknown class.
    """

    origins_m: Float32[Tensor, "B R 3"]
    ends_m: Float32[Tensor, "B R 3"]
    labels: UInt8[Tensor, "B R"]

    def without_classes(self) -> "Rays":
        """Return the rays with hits of unknown class."""
        return self._replace(labels=self.labels.where(self.labels == FREE, UNKNOWN))


@dataclass(frozen=True)
class RayWindow:
    """Which measured rays a frame is trained on.

    Attributes:
        frames: numbers of frames relative to the newest one of a sample; below 0 before it, above 0 after it. Frames
            that the scene does not have are left out.
        classes: whether the classes of the hits are used; False: only that something is hit.

    Raises:
        ValueError: if the newest frame itself (0) is not among the frames, or one of them occurs twice.
    """

    frames: Sequence[int]
    classes: bool

    def __post_init__(self) -> None:
        """Check the frames."""
        if 0 not in self.frames or len(set(self.frames)) < len(self.frames):
            raise ValueError(f"frames is {list(self.frames)}; give 0, the newest frame, and others once each")


class Queries(NamedTuple):
    """Places along rays at which a prediction is compared with what was measured.

    Attributes:
        cells: flat index of the cell of each.
        labels: 0 free, a class, or 255: occupied by an unknown class.
        counted: those that lie in the grid and do not contradict a hit.
    """

    cells: Int64[Tensor, "B M"]
    labels: UInt8[Tensor, "B M"]
    counted: Bool[Tensor, "B M"]


def draw_rays(rays: Rays, number: int, generator: torch.Generator) -> Rays:
    """Return at most `number` rays of each sample at random; `generator` is on the CPU."""
    missing = ~rays.origins_m.isfinite().all(-1)
    order = torch.rand(missing.shape, generator=generator).to(missing.device).masked_fill(missing, 2.0)
    chosen = order.topk(min(number, order.shape[1]), largest=False).indices
    origins_m, ends_m = (part.gather(1, chosen[..., None].expand(-1, -1, 3)) for part in rays[:2])
    return Rays(origins_m, ends_m, rays.labels.gather(1, chosen))


def hit_cells(grid: Grid, rays: Rays) -> tuple[Int64[Tensor, "B R"], Bool[Tensor, "B R"]]:
    """Return the flat index of the cell in which each ray ends, and which of them are hits in the grid."""
    cells, inside = grid.flat_index(rays.ends_m)
    return cells, inside & (rays.labels != FREE) & rays.origins_m.isfinite().all(-1)


def occupied_cells(grid: Grid, rays: Rays) -> Bool[Tensor, "B cells"]:
    """Return the cells in which a ray of the sample ends at a hit."""
    cells, hit = hit_cells(grid, rays)
    counts = torch.zeros(len(cells), grid.num_cells, dtype=torch.int32, device=cells.device)
    return counts.scatter_add_(1, cells, hit.int()) > 0


def ray_queries(grid: Grid, rays: Rays, places: Float32[Tensor, "B R Q"], occupied: Bool[Tensor, "B cells"]) -> Queries:
    """Return the end of every ray, then Q places before it.

    Args:
        grid: grid of the voxels.
        rays: R of each sample.
        places: of the free queries, from 0, where a ray enters the grid, to 1, where it leaves the grid or is half a
            cell (`MARGIN_CELLS`) before its hit.
        occupied: cells in which no query is free, since a ray ends there.
    """
    cells, hit = hit_cells(grid, rays)
    ways_m = (rays.ends_m - rays.origins_m).double()
    length_m = ways_m.norm(dim=-1)
    valid = length_m > 0  # false for nan
    directions = torch.where(valid[..., None], ways_m, 1.0).flatten(0, 1)
    directions = directions / directions.norm(dim=-1, keepdim=True)
    origins_m = rays.origins_m.double().nan_to_num(0.0).flatten(0, 1)
    start_m, leave_m = (part.view_as(length_m) for part in clip(grid, origins_m, directions))
    margin_m = MARGIN_CELLS * grid.radial_step_m * (rays.labels != FREE)
    stretch_m = torch.minimum(leave_m, length_m - margin_m) - start_m
    along_m = start_m[..., None] + places * stretch_m[..., None]
    points_m = rays.origins_m[..., None, :] + along_m[..., None] * directions.view_as(ways_m)[..., None, :]
    before, inside = (part.flatten(1) for part in grid.flat_index(points_m))
    free = inside & (valid & (stretch_m > 0)).repeat_interleave(places.shape[-1], 1) & ~occupied.gather(1, before)
    labels = torch.cat([rays.labels, torch.full_like(before, FREE, dtype=torch.uint8)], 1)
    return Queries(torch.cat([cells, before], 1), labels, torch.cat([hit, free], 1))


def unlikely_queries(logits: Float[Tensor, "B C *grid"], queries: Queries, free_weight: float) -> Float32[Tensor, ""]:
    """Return the mean cross-entropy of the hits, and `free_weight` times the mean of the free queries; 0 without any.

    A hit of unknown class counts by the probability that its cell is not free.
    """
    flat = logits.flatten(2)
    logarithm = flat.gather(2, queries.cells[:, None].expand(-1, flat.shape[1], -1)).float().log_softmax(1)
    known = queries.labels.long().masked_fill(queries.labels == UNKNOWN, FREE)
    own = logarithm.gather(1, known[:, None])[:, 0]
    likely = torch.where(queries.labels == UNKNOWN, logarithm[:, FREE + 1 :].logsumexp(1), own)
    is_free = queries.labels == FREE
    hits, before = queries.counted & ~is_free, queries.counted & is_free
    means = [-(likely * part).sum() / part.sum().clamp(min=1) for part in (hits, before)]
    return means[0] + free_weight * means[1]


class LidarRays(nn.Module):
    """Compare the voxels along measured rays with what the rays say, at places drawn anew in each step.

    Hits and free places have means of their own, so that neither outweighs the other. Places are spread evenly over
    each ray: a cell that rays graze, as on the road far ahead, has little weight as free. A cell in which any ray of
    the sample ends is never free. What is behind a hit gives no loss.

    Args:
        geometry: grid of the voxels.
        number: rays of a sample that are drawn in each step.
        queries: places before the end of each.
        free_weight: of the free places beside the hits.
    """

    def __init__(self, geometry: Grid, number: Number, queries: Count, free_weight: Weight):
        super().__init__()
        self.geometry, self.number, self.queries, self.free_weight = geometry, number, queries, free_weight

    def forward(
        self, logits: Float[Tensor, "B C *grid"], rays: Rays, generator: torch.Generator
    ) -> Float32[Tensor, ""]:
        """Return a scalar, computed in float32 also under autocast; 0 if no ray crosses the grid.

        Args:
            logits: of the classes of all voxels, free first.
            rays: measured ones of each sample.
            generator: of rays and places, on the CPU.
        """
        with torch.autocast(logits.device.type, enabled=False):
            occupied, drawn = occupied_cells(self.geometry, rays), draw_rays(rays, self.number, generator)
            steps = torch.arange(self.queries) + torch.rand(*drawn.labels.shape, self.queries, generator=generator)
            places = (steps / self.queries).to(logits.device)
            return unlikely_queries(logits, ray_queries(self.geometry, drawn, places, occupied), self.free_weight)
