"""Predict depth and occupancy from images of a calibrated rig, without recorded data."""

from omniocc.predict.input.images import FrameFiles, find_frames, read_frame, resized_to_width
from omniocc.predict.output.range_files import PointCloud, point_cloud, write_depth, write_ply
from omniocc.predict.predictor import PredictedFrame, Predictor, predict_depth
from omniocc.predict.trained import PredictedRanges, PredictedVoxels, Trained, load
from omniocc.predict.training_data import TrainingData

__all__ = [
    "FrameFiles",
    "PointCloud",
    "PredictedFrame",
    "PredictedRanges",
    "PredictedVoxels",
    "Predictor",
    "Trained",
    "TrainingData",
    "find_frames",
    "load",
    "point_cloud",
    "predict_depth",
    "read_frame",
    "resized_to_width",
    "write_depth",
    "write_ply",
]
