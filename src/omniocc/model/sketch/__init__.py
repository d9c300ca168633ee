"""Sketch slot: which voxels are worth colouring."""

from omniocc.model.protocols import LearnedSketch, Sketch, Sketched, learns
from omniocc.model.sketch.dense import Dense
from omniocc.model.sketch.omni import Omni
from omniocc.model.sketch.random import Random

__all__ = ["Dense", "LearnedSketch", "Omni", "Random", "Sketch", "Sketched", "learns"]
