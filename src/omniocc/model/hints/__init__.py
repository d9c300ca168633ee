"""Hints slot: what the sketch and the 2D head know of a voxel, for later slots; goes beyond the paper."""

from omniocc.model.hints.sketch_and_pixels import Known, SketchAndPixels

__all__ = ["Known", "SketchAndPixels"]
