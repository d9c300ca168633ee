"""Voxel grids around the vehicle, which are those of `rayiou`."""

from rayiou import (
    Cuboid,
    Cylinder,
    RayFans,
    Grid,
    Hits,
    RayPaths,
    RayTable,
    RayScan,
    center_cell_indices,
    downsample,
    sample_nearest,
    majority_vote,
    ray_table,
    resample,
)

__all__ = [
    "Cuboid",
    "Cylinder",
    "Fans",
    "Grid",
    "Hits",
    "Paths",
    "RayTable",
    "Scan",
    "cells_of_middles",
    "downsample",
    "look_up",
    "majority",
    "ray_table",
    "resample",
]
