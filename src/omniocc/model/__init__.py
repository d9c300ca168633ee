"""The occupancy network and its slots."""

from omniocc.model.occupancy import Lifted, OccupancyModel, Prediction, labels_of, probabilities_of
from omniocc.model.stream import Stream

__all__ = ["Lifted", "OccupancyModel", "Prediction", "Stream", "labels_of", "probabilities_of"]
