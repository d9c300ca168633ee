"""Pseudo point cloud of a panorama of ranges, and its features in the cells of a grid."""

from functools import lru_cache

import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor, nn
from torch.nn import functional as F

from omniocc.camera import Equirectangular
from omniocc.geometry import Grid
from omniocc.model.ops.static import is_static


def pseudo_points(
    range_m: Float[Tensor, "B h w"], valid: Bool[Tensor, "B h w"], panorama: Equirectangular
) -> Float[Tensor, "B P 3"]:
    """Return the point that each pixel sees, ego frame, row by row; nan where the range is not valid."""
    points = range_m.float().unsqueeze(-1) * panorama.rays(range_m.device)
    return torch.where(valid.unsqueeze(-1), points, torch.nan).flatten(1, 2)


def still_axes(geometry: Grid) -> list[int]:
    """Return the axes that do not wrap around."""
    return [axis for axis in range(3) if not geometry.periodic[axis]]


def point_features(points: Float[Tensor, "P 3"], geometry: Grid) -> Float[Tensor, "P F"]:
    """Return the features that Cylinder3D has of points in the grid (ego frame, m): offset in the cell, place, range.

    Offsets from the cell's centre are in cells, places from -1 to 1 over the grid, ranges in units of the grid's reach.
    Cylinder3D's azimuth, x and y are left out in a cylinder, so that turning the car turns the sketch.
    """
    places = torch.stack(geometry.coordinates(points), dim=-1)
    offset = places - places.floor() - 0.5
    cells = torch.tensor(geometry.shape, device=points.device)
    axes = still_axes(geometry)
    coordinates = (2 * places / cells - 1)[:, axes]
    return torch.cat([offset, coordinates, points.norm(dim=-1, keepdim=True) / reach_m(geometry)], dim=-1)


@lru_cache(maxsize=16)
def reach_m(geometry: Grid) -> float:
    """Return the horizontal distance of the farthest column."""
    return float(geometry.distances_m().max())


def voxel_max(
    features: Float[Tensor, "P C"], cells: Int64[Tensor, " P"], num_cells: int
) -> Float[Tensor, "num_cells C"]:
    """Return the largest value of each feature among the points of a cell; 0 if negative or without points."""
    index = cells.unsqueeze(1).expand_as(features)
    return features.new_zeros(num_cells, features.shape[1]).scatter_reduce(0, index, features, "amax")


class PointEncoder(nn.Module):
    """Encode the points of every cell: an MLP on each point, the maximum in each cell."""

    def __init__(self, geometry: Grid, channels: int):
        super().__init__()
        self.geometry = geometry
        self.channels = channels
        self.hidden = nn.Linear(4 + len(still_axes(geometry)), channels)
        self.out = nn.Linear(channels, channels)

    def forward(self, points: Float[Tensor, "B P 3"]) -> tuple[Float[Tensor, "B C X Y Z"], Float[Tensor, "B 1 X Y Z"]]:
        """Return features, at least 0 and 0 in cells without points, and the mask of cells with points (0 or 1).

        Points outside the grid or not finite are ignored.
        """
        cells, inside = self.geometry.flat_index(points)
        cells = cells + torch.arange(len(points), device=points.device).unsqueeze(1) * self.geometry.num_cells
        static = is_static()
        points, places = (points.flatten(0, 1), cells.flatten()) if static else (points[inside], cells[inside])
        encoded = F.relu(self.out(F.relu(self.hidden(point_features(points, self.geometry)))))
        marked = torch.cat([encoded, torch.ones_like(encoded[:, :1])], dim=1)
        if static:  # ignored points add zeros, which do not change the maximum
            marked = torch.where(inside.flatten()[:, None], marked, 0)
        volume = voxel_max(marked, places, len(inside) * self.geometry.num_cells)
        volume = volume.reshape(len(inside), *self.geometry.shape, -1).movedim(-1, 1)
        return volume[:, :-1], volume[:, -1:]
