"""Metrics of occupancy, which are those of `rayiou`, and of depth and candidates."""

from omniocc.metric.calibration import CalibrationError
from omniocc.metric.candidates import CandidateScores
from omniocc.metric.depth import DepthMetrics, sphere_index
from rayiou import (
    RayIoU,
    RayOrigins,
    RayTruth,
    VoxelIoU,
    sparseocc_origins,
    ray_hits,
    ray_iou,
    sparseocc_directions,
    trajectory_origins,
)

__all__ = [
    "Calibration",
    "Candidates",
    "DepthMetrics",
    "RayIoU",
    "RayOrigins",
    "RayTruth",
    "VoxelIoU",
    "eight_origins",
    "ray_hits",
    "ray_iou",
    "sparseocc_directions",
    "sphere_index",
    "trajectory_origins",
]
