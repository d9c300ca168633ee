"""The occupancy network and its slots."""

from omniocc.model.occupancy import Lifted, OccupancyModel, Prediction, decide
from omniocc.model.stream import Stream

__all__ = ["Lifted", "OccupancyModel", "Prediction", "Stream", "decide"]
