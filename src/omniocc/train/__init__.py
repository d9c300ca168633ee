"""Lightning modules of the stages, and what trains them."""

from omniocc.train.adamw import AdamW
from omniocc.train.callbacks import StepProgress, TrainingTime
from omniocc.train.depth import DepthTask
from omniocc.train.muon import Muon
from omniocc.train.occupancy import OccupancyTask
from omniocc.train.sketch import SketchTask
from omniocc.train.stage_task import Recipe

__all__ = [
    "AdamW",
    "DepthTask",
    "Muon",
    "OccupancyTask",
    "Recipe",
    "SketchTask",
    "StepProgress",
    "TrainingTime",
]
