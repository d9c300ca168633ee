"""Labels of one grid in another: what a dataset's voxels say about the cells of a model, and back."""

import itertools
import math
from functools import lru_cache
from typing import NamedTuple

import torch
from jaxtyping import Int32, Int64, UInt8
from torch import Tensor

from rayiou.grid import Grid
from rayiou.labels import FREE, UNKNOWN

LEAST_OCCUPIED = 0.4
"""Share of a cell that must be occupied for the cell to be."""
MOST_PLACES = 8
"""Places along each axis of a cell."""


def resample(
    labels: UInt8[Tensor, "X Y Z"], source: Grid, target: Grid, least: float = LEAST_OCCUPIED
) -> UInt8[Tensor, "U V W"]:
    """Return the classes that the cells of `target` have according to labels of the cells of `source`.

    Every target cell is sampled at evenly spread places, two for each length of a source cell (at most 8 along an
    axis). If `least` or more of the known places are occupied, their most frequent class is that of the cell. Otherwise
    the cell is free, or unknown (255) if most places are unknown or outside of `source`. Equal grids give the labels
    themselves.

    Args:
        labels: class of every cell, 255 unknown.
        source: grid of the labels.
        target: grid of the result.
        least: fraction of the known places of a cell that must be occupied.

    Raises:
        ValueError: if the labels are not of the source's shape.
    """
    if tuple(labels.shape) != source.shape:
        raise ValueError(f"labels must have the shape of their grid, {source.shape}, got {tuple(labels.shape)}")
    if source == target:
        return labels
    places = _places(source, target)
    flat = labels.flatten()
    occupied = ((flat != FREE) & (flat != UNKNOWN)).nonzero().flatten()
    counts = places.count_of_source[occupied]
    entries = torch.repeat_interleave(places.end_of_source[occupied] - counts.cumsum(0), counts)
    cells = places.sorted_cells[entries + torch.arange(len(entries))].long()
    classes = torch.repeat_interleave(flat[occupied].long(), counts)
    num_classes = int(flat[occupied].max()) + 1 if len(occupied) else 1
    votes = torch.bincount(cells * num_classes + classes, minlength=target.num_cells * num_classes)
    votes = votes.reshape(target.num_cells, num_classes)
    known = places.inside
    if bool((flat == UNKNOWN).any()):
        known = torch.cat([flat != UNKNOWN, torch.zeros(1, dtype=torch.bool)])[places.sources].sum(1)
    total = votes.sum(1)
    empty = torch.where(2 * known < places.sources.shape[1], UNKNOWN, FREE)
    chosen = torch.where((total > 0) & (total >= least * known), votes.argmax(1), empty)
    return chosen.to(torch.uint8).reshape(target.shape)


def sample_nearest(labels: UInt8[Tensor, "B X Y Z"], source: Grid, target: Grid) -> UInt8[Tensor, "B U V W"]:
    """Return the class at the middle of every cell of `target`; free outside of `source`.

    So predictions are scored: on the cells of the dataset, whatever the grid of the model.
    """
    if source == target:
        return labels
    cells = center_cell_indices(source, target).to(labels.device).long()
    padded = torch.cat([labels.flatten(1), labels.new_full((len(labels), 1), FREE)], dim=1)
    return padded[:, cells].reshape(len(labels), *target.shape)


@lru_cache(maxsize=4)
def center_cell_indices(source: Grid, target: Grid) -> Int32[Tensor, " cells"]:
    """Return the source cell of every target cell's middle, `source.num_cells` where it is outside."""
    index, inside = source.flat_index(target.centers(torch.float64).reshape(-1, 3))
    return torch.where(inside, index, source.num_cells).to(torch.int32)


class Places(NamedTuple):
    """Where the sampled places of target cells lie in the source.

    Attributes:
        sources: source cell of every place, `source.num_cells` outside.
        inside: number of places of each target cell that are inside of the source.
        sorted_cells: target cells of all places in order of their source cells.
        count_of_source: places in every source cell.
        end_of_source: index into `sorted_cells` behind the last place of a source cell.
    """

    sources: Int32[Tensor, "cells places"]
    inside: Int64[Tensor, " cells"]
    sorted_cells: Int32[Tensor, " all"]
    count_of_source: Int64[Tensor, " sources"]
    end_of_source: Int64[Tensor, " sources"]


@lru_cache(maxsize=4)
def _places(source: Grid, target: Grid) -> Places:
    """Return places spread evenly over every target cell, two for each length of a source cell."""
    across_m = min(source.cell_m[:2])
    counts = [
        min(MOST_PLACES, math.ceil(2 * size / finest - 1e-9))
        for size, finest in zip(target.cell_m, (across_m, across_m, source.cell_m[2]), strict=True)
    ]
    parts = []
    for shift in itertools.product(*((torch.arange(n, dtype=torch.float64) + 0.5) / n for n in counts)):
        edges = [target.edges(axis) for axis in range(3)]
        axes = [low[:-1] + fraction * low.diff() for low, fraction in zip(edges, shift, strict=True)]
        points = target.from_axes(*torch.meshgrid(*axes, indexing="ij")).reshape(-1, 3)
        index, inside = source.flat_index(points)
        parts.append(torch.where(inside, index, source.num_cells).to(torch.int32))
    sources = torch.stack(parts, dim=1)
    order = sources.flatten().argsort()
    count = torch.bincount(sources.flatten(), minlength=source.num_cells + 1)
    cells = (order // sources.shape[1]).to(torch.int32)
    return Places(sources, (sources < source.num_cells).sum(1), cells, count[:-1], count.cumsum(0)[:-1])
