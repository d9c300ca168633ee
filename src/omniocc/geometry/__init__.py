"""Voxel grids around the vehicle."""

from omniocc.geometry.cuboid import Cuboid
from omniocc.geometry.cylinder import Cylinder
from omniocc.geometry.grid import Grid
from omniocc.geometry.table import RayTable, ray_table
from omniocc.geometry.trace import Hits, Paths

__all__ = ["Cuboid", "Cylinder", "Grid", "Hits", "Paths", "RayTable", "ray_table"]
