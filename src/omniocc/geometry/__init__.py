"""Voxel grids around the vehicle."""

from omniocc.geometry.cuboid import Cuboid
from omniocc.geometry.cylinder import Cylinder
from omniocc.geometry.grid import Grid
from omniocc.geometry.raycast.fans import Fans, Scan
from omniocc.geometry.raycast.table import RayTable, ray_table
from omniocc.geometry.raycast.trace import Hits, Paths
from omniocc.geometry.resample import cells_of_middles, look_up, resample
from omniocc.geometry.vote import downsample, majority

__all__ = [
    "Cuboid", "Cylinder", "Fans", "Grid", "Hits", "Paths", "RayTable", "Scan", "cells_of_middles", "downsample",
    "look_up", "majority", "ray_table", "resample",
]  # fmt: skip
