"""Lightning modules of the stages, and what trains them."""

from omniocc.task.adamw import AdamW
from omniocc.task.depth import DepthTask
from omniocc.task.muon import Muon
from omniocc.task.occupancy import OccupancyTask
from omniocc.task.progress import StepProgress, TrainingTime
from omniocc.task.scores import Scores
from omniocc.task.sketch import SketchTask
from omniocc.task.stage_task import Recipe

__all__ = [
    "AdamW",
    "DepthTask",
    "Muon",
    "OccupancyTask",
    "Recipe",
    "Scores",
    "SketchTask",
    "StepProgress",
    "TrainingTime",
]
