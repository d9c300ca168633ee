"""What a checkpoint's configuration tells about the data that its model was trained on."""

from dataclasses import dataclass
from pathlib import Path

from omegaconf import DictConfig, OmegaConf

from omniocc.camera import Rig
from omniocc.classes import ClassTable
from omniocc.config import build
from omniocc.data import OccupancyData
from omniocc.data.source import SceneSource, Unknown
from omniocc.errors import UserError
from omniocc.run.checkpoint import check_parts


@dataclass(frozen=True)
class TrainingData:
    """The data that a model was trained on.

    Attributes:
        rig: its cameras, at the size of its images.
        rig_name: name or file of the rig, or a phrase where scenes are recorded.
        road_z_m: height of the road in its ego frame.
        classes: table of the model's classes.
        unknown: label of true cells without points.
    """

    rig: Rig
    rig_name: str
    road_z_m: float
    classes: ClassTable
    unknown: Unknown

    @property
    def image_size(self) -> tuple[int, int]:
        """Return width and height of the first camera's images, px."""
        return self.rig.cameras[0].width, self.rig.cameras[0].height


def training_data(path: Path, cfg: DictConfig) -> TrainingData:
    """Return what the data source in `cfg`, the configuration of the checkpoint at `path`, tells about its data.

    Raises:
        UserError: when the source cannot be built here, needs scenes that are not there, or has other classes.
    """
    if "data" not in cfg:
        raise UserError(f"{path} is of another version: its configuration has no data")
    check_parts(path, cfg, ["data"])
    data: OccupancyData = build(cfg.data)
    data.check_classes()
    source, spec = data.source, data.source.spec
    name = OmegaConf.select(cfg, "data.source.rig") or "that of recorded scenes"
    return TrainingData(training_rig(source), name, spec.road_z_m, spec.classes, data.unknown)


def training_rig(source: SceneSource) -> Rig:
    """Return the cameras of a source, or those of its first training frame if they may differ.

    Raises:
        UserError: when there are no training scenes.
    """
    rig = getattr(source, "rig", None)  # of sources whose scenes all have the same cameras
    if rig is not None:
        return rig
    scenes = source.scenes("train")
    if not scenes:
        raise UserError("the model's training data has no training scenes, whose cameras are needed")
    return scenes[0].rigs[0]
