"""Hints slot: what the sketch and the 2D head know of a voxel, for later slots; goes beyond the paper."""

from omniocc.model.hints.none import NoHints
from omniocc.model.hints.sketch_and_pixels import SketchAndPixels
from omniocc.model.protocols import Hints, Known

__all__ = ["Hints", "Known", "NoHints", "SketchAndPixels"]
