"""Pairs of voxels and the cameras that see them, with pixels; samples of a batch that have them in common."""

from typing import NamedTuple

import torch
from jaxtyping import Bool, Float, Float32, Int64
from torch import Tensor

from omniocc.camera import Rig, normalize_pixels
from omniocc.geometry import Grid
from omniocc.model.ops.blocks import points_in_cells
from omniocc.model.ops.padded import frame_size
from omniocc.model.ops.rig_cache import once_per_rig

Anchors = tuple[tuple[float, float, float], ...]
CENTRE: Anchors = ((0.0, 0.0, 0.0),)
OUTSIDE = -1e4
"""Coordinate of an anchor in a camera that does not see it: thousands of image widths away, too far for offsets."""


class Pairs(NamedTuple):
    """All pairs of a query and a camera that sees an anchor of the query's voxel, sorted by query.

    Attributes:
        query: number of each pair's query.
        camera: number of its camera.
        points: projected anchors in `grid_sample` coordinates; far outside if not visible.
        counts: cameras that see each query.
        first: index of each query's first pair.
    """

    query: Int64[Tensor, " P"]
    camera: Int64[Tensor, " P"]
    points: Float[Tensor, "P A 2"]
    counts: Int64[Tensor, " Q"]
    first: Int64[Tensor, " Q"]


Queried = tuple[Int64[Tensor, " E"], Int64[Tensor, " Q"], Pairs]


@once_per_rig
def reference_points(
    rig: Rig, geometry: Grid, device: torch.device, anchors: Anchors = CENTRE
) -> tuple[Float32[Tensor, "N cells A 2"], Bool[Tensor, "N cells"]]:
    """Project the anchors of all cells into all cameras: `grid_sample` coordinates, and the mask of visible cells.

    Anchors are offsets from the middle of the cell along the grid's axes, in cells. A cell is visible if one of its
    anchors is; the coordinates of other anchors are far outside the image. The result is cached for each rig: never
    write to it.
    """
    places = [[0.5 + offset for offset in anchor] for anchor in anchors]
    pixels, valid = rig.project(points_in_cells(geometry, places).movedim(0, -2).flatten(0, 2))
    points = torch.where(valid[..., None], normalize_pixels(pixels, *frame_size(rig)), OUTSIDE)
    return points.to(device=device, dtype=torch.float32), valid.any(-1).to(device)


def visible_pairs(
    points: Float32[Tensor, "N cells A 2"], valid: Bool[Tensor, "N cells"], cells: Int64[Tensor, " Q"]
) -> Pairs:
    """Return the pairs of the queries at `cells` (row-major indices)."""
    seen = valid.T[cells]
    query, camera = seen.nonzero(as_tuple=True)
    counts = seen.sum(1)
    return Pairs(query, camera, points[camera, cells[query]], counts, counts.cumsum(0) - counts)


def marked_cells(
    marked: Bool[Tensor, " cells"], rig: Rig, geometry: Grid, device: torch.device, anchors: Anchors
) -> Queried:
    """Return the marked cells, those of them that any camera sees (as indices into them), and the cameras that do."""
    points, valid = reference_points(rig, geometry, device, anchors)
    cells = marked.nonzero()[:, 0]
    seen = valid.any(0)[cells].nonzero()[:, 0]
    return cells, seen, visible_pairs(points, valid, cells[seen])


@once_per_rig
def every_cell(rig: Rig, geometry: Grid, device: torch.device, anchors: Anchors) -> Queried:
    """Return the result of `marked_cells` for all cells; never write to the result, which is cached."""
    everything = torch.ones(geometry.num_cells, dtype=torch.bool, device=device)
    return marked_cells(everything, rig, geometry, device, anchors)


def group_samples(rigs: tuple[Rig, ...], *content: Tensor | None) -> list[list[int]]:
    """Return groups of samples that have the rig and all content (first axis: samples) in common."""
    groups: list[list[int]] = []
    for sample, rig in enumerate(rigs):
        for group in groups:
            first = group[0]
            if rigs[first] == rig and all(part is None or torch.equal(part[first], part[sample]) for part in content):
                group.append(sample)
                break
        else:
            groups.append([sample])
    return groups
