"""Lightning modules of the stages, and what a run needs around them."""

from omniocc.task.adamw import AdamW
from omniocc.task.loggers import Loggers
from omniocc.task.occupancy import Occupancy
from omniocc.task.progress import StepProgress
from omniocc.task.scores import Scores

__all__ = ["AdamW", "Loggers", "Occupancy", "Scores", "StepProgress"]
