"""Scores of occupancy."""

from omniocc.metric.directions import sparseocc_directions
from omniocc.metric.ray_iou import RayIoU, ray_iou
from omniocc.metric.voxel_iou import VoxelIoU

__all__ = ["RayIoU", "VoxelIoU", "ray_iou", "sparseocc_directions"]
