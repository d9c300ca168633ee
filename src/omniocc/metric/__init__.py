"""Metrics of occupancy and depth."""

from omniocc.geometry.directions import RayOrigins, eight_origins, sparseocc_directions, trajectory_origins
from omniocc.metric.calibration import Calibration
from omniocc.metric.candidates import Candidates
from omniocc.metric.depth import DepthMetrics, sphere_index
from omniocc.metric.ray_hits import ray_hits
from omniocc.metric.ray_iou import RayIoU, RayTruth, ray_iou
from omniocc.metric.voxel_iou import VoxelIoU

__all__ = [
    "Calibration", "Candidates", "DepthMetrics", "RayIoU", "RayOrigins", "RayTruth", "VoxelIoU", "eight_origins",
    "ray_hits", "ray_iou", "sparseocc_directions", "sphere_index", "trajectory_origins",
]  # fmt: skip
