"""Voxel grids around the vehicle."""

from omniocc.geometry.cuboid import Cuboid
from omniocc.geometry.cylinder import Cylinder
from omniocc.geometry.grid import Grid

__all__ = ["Cuboid", "Cylinder", "Grid"]
