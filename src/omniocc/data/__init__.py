"""Recorded scenes: on disk, as datasets, as batches."""

from omniocc.data.dataset import WindowDataset, collate
from omniocc.data.errors import DataError
from omniocc.data.module import OccupancyData
from omniocc.data.reader import SceneReader
from omniocc.data.virtual import VirtualWorld

__all__ = ["DataError", "OccupancyData", "SceneReader", "VirtualWorld", "WindowDataset", "collate"]
