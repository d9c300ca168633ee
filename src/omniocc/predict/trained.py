"""What a checkpoint's configuration tells about the data that its model was trained on."""

from dataclasses import dataclass

from omegaconf import DictConfig

from omniocc.classes import WORLD_CLASSES, ClassTable
from omniocc.data.labels.voxels import Unknown

ROAD_Z_M = -2.2
"""Height of the road in the ego frame of the virtual world."""


@dataclass(frozen=True)
class TrainingData:
    """The data that a model was trained on.

    Attributes:
        rig: name or file of its rig.
        image_size: width and height of its images, px.
        road_z_m: height of the road in its ego frame.
        classes: table of the model's classes.
        unknown: label of true cells without points.
    """

    rig: str
    image_size: tuple[int, int]
    road_z_m: float
    classes: ClassTable
    unknown: Unknown


def training_data(cfg: DictConfig) -> TrainingData:
    """Return what the configuration of a checkpoint tells about its data."""
    width, height = cfg.data.world.image_size
    return TrainingData(cfg.data.world.rig, (width, height), ROAD_Z_M, WORLD_CLASSES, cfg.data.unknown)
