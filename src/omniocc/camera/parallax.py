"""How well the cameras of a rig can measure ranges: the parallax between pairs of them."""

from itertools import combinations

import torch
from jaxtyping import Bool, Float, Float64
from torch import Tensor

from omniocc.camera.rig import Rig

TURN_RAD = 1e-5
"""Angle by which directions are turned to measure the pixels per radian."""


def pixels_per_metre(rig: Rig, points_ego: Float[Tensor, "*batch 3"]) -> Float64[Tensor, "*batch"]:
    """Return the pixels of disparity for each metre of error in a point's range from the ego origin.

    The pair of cameras with the most disparity counts; 0 where fewer than two cameras see the point. `points_ego` are
    in metres.
    """
    points = points_ego.double()
    outward = torch.nn.functional.normalize(points, dim=-1)
    centers = rig.ego_from_camera[:, :3, 3].to(points)
    sight = points - centers.reshape(-1, *[1] * (points.ndim - 1), 3)
    distance_m = sight.norm(dim=-1, keepdim=True).clamp(min=1e-9)
    directions = sight / distance_m
    turn_per_metre = (outward - directions * (directions * outward).sum(-1, keepdim=True)) / distance_m
    scale, seen = _pixels_per_radian(rig, points, directions, distance_m)
    best = torch.zeros_like(points[..., 0])
    for one, other in combinations(range(len(rig.cameras)), 2):
        transported = _transport(turn_per_metre[other], directions[other], directions[one])
        disparity = (turn_per_metre[one] - transported).norm(dim=-1) * torch.minimum(scale[one], scale[other])
        best = torch.maximum(best, disparity.where(seen[one] & seen[other], 0))
    return best


def shared_view(rig: Rig, points_ego: Float[Tensor, "*batch 3"]) -> float:
    """Return the fraction of points (m) seen by two or more cameras among those that any camera sees; 0 if none is."""
    views = rig.project(points_ego)[1].sum(0)
    return float((views > 1).sum() / (views > 0).sum().clamp(min=1))


def _transport(
    tangents: Float64[Tensor, "*batch 3"], start: Float64[Tensor, "*batch 3"], end: Float64[Tensor, "*batch 3"]
) -> Float64[Tensor, "*batch 3"]:
    """Return tangent vectors of the unit sphere at `start`, parallel transported along the great circle to `end`."""
    both = start + end
    along = (tangents * end).sum(-1, keepdim=True) / (1 + (start * end).sum(-1, keepdim=True)).clamp(min=1e-9)
    return tangents - along * both


def _pixels_per_radian(
    rig: Rig,
    points: Float64[Tensor, "*batch 3"],
    directions: Float64[Tensor, "N *batch 3"],
    distance_m: Float64[Tensor, "N *batch 1"],
) -> tuple[Float64[Tensor, "N *batch"], Bool[Tensor, "N *batch"]]:
    """Return pixels per radian at each point in each camera, as a mean over directions, and where it is seen."""
    axis = torch.zeros_like(directions).scatter(-1, directions.abs().argmin(-1, keepdim=True), 1.0)
    right = torch.nn.functional.normalize(torch.linalg.cross(directions, axis), dim=-1)
    moved = [points + TURN_RAD * distance_m * turn for turn in (right, torch.linalg.cross(directions, right))]
    pixels, seen = rig.project(points)
    sides = [
        (torch.stack([rig.project_into(i, turned[i])[0] for i in range(len(rig.cameras))]) - pixels) / TURN_RAD
        for turned in moved
    ]
    area = sides[0][..., 0] * sides[1][..., 1] - sides[0][..., 1] * sides[1][..., 0]
    return area.abs().sqrt(), seen  # a geometric mean
