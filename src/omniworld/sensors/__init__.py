"""Sensors of the ego: `recorder.Recorder` records one frame with all of them.

Labels of points, by `label_mode`: `semantic_lidars` (lidar20), `geometry_labels` (geometry); rays: `lidar`.
"""
