"""Sources of scenes, their storage, and datasets and batches made of them."""

from omniocc.data.augment.appearance import Appearance
from omniocc.data.augment.augment import Augment
from omniocc.data.augment.disturbances import Disturbances
from omniocc.data.dataset import Needs, WindowDataset, collate
from omniocc.data.module import OccupancyData
from omniocc.data.source import SceneSource, SourceSpec
from omniocc.data.source.recorded import Recorded
from omniocc.data.store.frame_cache import CandidateCache, EvidenceCache, RangeCache
from omniocc.data.store.reader import SceneReader
from omniocc.errors import DataError

__all__ = [
    "Appearance",
    "Augment",
    "CandidateCache",
    "DataError",
    "Disturbances",
    "EvidenceCache",
    "Needs",
    "OccupancyData",
    "RangeCache",
    "Recorded",
    "SceneReader",
    "SceneSource",
    "SourceSpec",
    "WindowDataset",
    "collate",
]
