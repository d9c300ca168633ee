"""Lifter slot: from image features to voxel features."""

from omniocc.model.lifter.coarse_coloring import CoarseColoring
from omniocc.model.lifter.coloring import Coloring
from omniocc.model.lifter.lift_splat import LiftSplat
from omniocc.model.lifter.pillar import Pillar
from omniocc.model.protocols import Lifter, PredictsRanges

__all__ = [
    "CoarseColoring",
    "Coloring",
    "LiftSplat",
    "Lifter",
    "Pillar",
    "PredictsRanges",
]
