"""From pictures of a calibrated rig to files, without recorded data."""

from omniocc.predict.cloud import cloud_of, write_ply
from omniocc.predict.images import Frame, find_frames, read_frame, resized_to_width
from omniocc.predict.network import load_depth, predict_depth
from omniocc.predict.output import write_depth

__all__ = [
    "Frame",
    "cloud_of",
    "find_frames",
    "load_depth",
    "predict_depth",
    "read_frame",
    "resized_to_width",
    "write_depth",
    "write_ply",
]
