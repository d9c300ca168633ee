"""Voxel labels of a grid from recorded points and rays."""
