"""The occupancy network and its slots."""

from omniocc.model.occupancy import OccupancyModel, Prediction

__all__ = ["OccupancyModel", "Prediction"]
