"""Voxel grids around the vehicle, which are those of `rayiou`."""

from rayiou import (
    Cuboid,
    Cylinder,
    Grid,
    Hits,
    RayFans,
    RayPaths,
    RayScan,
    RayTable,
    center_cell_indices,
    downsample,
    majority_vote,
    ray_table,
    resample,
    sample_nearest,
)

__all__ = [
    "Cuboid",
    "Cylinder",
    "Grid",
    "Hits",
    "RayFans",
    "RayPaths",
    "RayScan",
    "RayTable",
    "center_cell_indices",
    "downsample",
    "majority_vote",
    "ray_table",
    "resample",
    "sample_nearest",
]
