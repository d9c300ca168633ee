"""Metrics of occupancy, which are those of `rayiou`, and of depth and candidates."""

from omniocc.metric.calibration import CalibrationError
from omniocc.metric.candidates import CandidateScores
from omniocc.metric.depth import DepthMetrics, sphere_index
from rayiou import (
    RayIoU,
    RayOrigins,
    RayTruth,
    VoxelIoU,
    ray_hits,
    ray_iou,
    sparseocc_directions,
    sparseocc_origins,
    trajectory_origins,
)

__all__ = [
    "CalibrationError",
    "CandidateScores",
    "DepthMetrics",
    "RayIoU",
    "RayOrigins",
    "RayTruth",
    "VoxelIoU",
    "ray_hits",
    "ray_iou",
    "sparseocc_directions",
    "sparseocc_origins",
    "sphere_index",
    "trajectory_origins",
]
