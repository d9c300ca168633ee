"""Predict depth and occupancy from images of a calibrated rig, without recorded data."""

from omniocc.predict.input.images import Frame, find_frames, read_frame, resized_to_width
from omniocc.predict.network import load_depth, load_occupancy, predict_depth
from omniocc.predict.output.panorama_files import write_depth
from omniocc.predict.output.point_cloud import PointCloud, point_cloud, write_ply
from omniocc.predict.predictor import Prediction, Predictor

__all__ = [
    "Frame", "PointCloud", "Prediction", "Predictor", "find_frames", "load_depth", "load_occupancy", "point_cloud",
    "predict_depth", "read_frame", "resized_to_width", "write_depth", "write_ply",
]  # fmt: skip
