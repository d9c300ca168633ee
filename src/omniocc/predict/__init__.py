"""From pictures of a calibrated rig to files, without recorded data."""

from omniocc.predict.input.images import Frame, find_frames, read_frame, resized_to_width
from omniocc.predict.network import load_depth, load_occupancy, predict_depth
from omniocc.predict.output.cloud import cloud_of, write_ply
from omniocc.predict.output.panorama_files import write_depth
from omniocc.predict.predictor import Predictor

__all__ = [
    "Frame",
    "Predictor",
    "cloud_of",
    "find_frames",
    "load_depth",
    "load_occupancy",
    "predict_depth",
    "read_frame",
    "resized_to_width",
    "write_depth",
    "write_ply",
]
