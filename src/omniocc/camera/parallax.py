"""How well the cameras of a rig can measure ranges: the parallax between pairs of them."""

from itertools import combinations

import torch
from jaxtyping import Bool, Float, Float64
from torch import Tensor

from omniocc.camera.rig import Rig

STEP = 1e-5
"""Angle, rad, by which directions are turned to see how many pixels a radian has."""


def pixels_per_metre(rig: Rig, points_ego: Float[Tensor, "*batch 3"]) -> Float64[Tensor, "*batch"]:
    """Return by how many pixels the images of a point part, for each metre of its range from the ego origin.

    That of the best pair of cameras: a wrong range of `e` m shows as `e` times as many pixels of disparity. 0 where
    fewer than two cameras see the point. `points_ego` are in metres.
    """
    points = points_ego.double()
    away = torch.nn.functional.normalize(points, dim=-1)
    centers = rig.ego_from_camera[:, :3, 3].to(points)
    sight = points - centers.reshape(-1, *[1] * (points.ndim - 1), 3)
    distance_m = sight.norm(dim=-1, keepdim=True).clamp(min=1e-9)
    directions = sight / distance_m
    turning = (away - directions * (directions * away).sum(-1, keepdim=True)) / distance_m
    scale, seen = _pixels_per_radian(rig, points, directions, distance_m)
    best = torch.zeros_like(points[..., 0])
    for one, other in combinations(range(len(rig.cameras)), 2):
        alike = _carried(turning[other], directions[other], directions[one])
        parting = (turning[one] - alike).norm(dim=-1) * torch.minimum(scale[one], scale[other])
        best = torch.maximum(best, parting.where(seen[one] & seen[other], 0))
    return best


def shared_view(rig: Rig, points_ego: Float[Tensor, "*batch 3"]) -> float:
    """Return the fraction of points (m) seen by two or more cameras among those that any camera sees; 0 if none is."""
    views = rig.project(points_ego)[1].sum(0)
    return float((views > 1).sum() / (views > 0).sum().clamp(min=1))


def _carried(
    moves: Float64[Tensor, "*batch 3"], start: Float64[Tensor, "*batch 3"], end: Float64[Tensor, "*batch 3"]
) -> Float64[Tensor, "*batch 3"]:
    """Return moves on the unit sphere at `start`, turned by the smallest rotation that takes `start` to `end`."""
    both = start + end
    along = (moves * end).sum(-1, keepdim=True) / (1 + (start * end).sum(-1, keepdim=True)).clamp(min=1e-9)
    return moves - along * both


def _pixels_per_radian(
    rig: Rig,
    points: Float64[Tensor, "*batch 3"],
    directions: Float64[Tensor, "N *batch 3"],
    distance_m: Float64[Tensor, "N *batch 1"],
) -> tuple[Float64[Tensor, "N *batch"], Bool[Tensor, "N *batch"]]:
    """Return pixels per radian around each point in each camera, the mean of both directions, and where it is seen."""
    axis = torch.zeros_like(directions).scatter(-1, directions.abs().argmin(-1, keepdim=True), 1.0)
    right = torch.nn.functional.normalize(torch.linalg.cross(directions, axis), dim=-1)
    moved = [points + STEP * distance_m * turn for turn in (right, torch.linalg.cross(directions, right))]
    pixels, seen = rig.project(points)
    sides = [
        (torch.stack([rig.project_into(i, turned[i])[0] for i in range(len(rig.cameras))]) - pixels) / STEP
        for turned in moved
    ]
    area = sides[0][..., 0] * sides[1][..., 1] - sides[0][..., 1] * sides[1][..., 0]
    return area.abs().sqrt(), seen
