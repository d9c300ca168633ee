"""Lightning modules of the stages, and what a run needs around them."""

from omniocc.task.adamw import AdamW
from omniocc.task.depth import Depth
from omniocc.task.occupancy import Occupancy
from omniocc.task.progress import StepProgress
from omniocc.task.recipe import Recipe
from omniocc.task.scores import Scores
from omniocc.task.sketch import Sketch

__all__ = ["AdamW", "Depth", "Occupancy", "Recipe", "Scores", "Sketch", "StepProgress"]
