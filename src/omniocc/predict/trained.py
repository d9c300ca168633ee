"""What a checkpoint's configuration tells about the data that its model was trained on."""

from dataclasses import dataclass
from pathlib import Path

from omegaconf import DictConfig, OmegaConf

from omniocc.camera import Rig
from omniocc.classes import ClassTable
from omniocc.config import build
from omniocc.data import OccupancyData
from omniocc.data.source import Unknown
from omniocc.data.source.cameras import training_rig
from omniocc.errors import UserError
from omniocc.run.checkpoint import check_parts


@dataclass(frozen=True)
class TrainingData:
    """The data that a model was trained on.

    Attributes:
        rig: its cameras, at the size of its images; those of its first frame, if they differ.
        rig_name: name or file of the rig, `random`, or a phrase where scenes are recorded.
        road_z_m: height of the road in its ego frame, m; None: another one in every scene, as with drawn rigs.
        classes: table of the model's classes.
        unknown: label of true cells without points.
        frame_interval_s: time between frames, and so the age of the newest past one, s.
    """

    rig: Rig
    rig_name: str
    road_z_m: float | None
    classes: ClassTable
    unknown: Unknown
    frame_interval_s: float

    @property
    def any_rig(self) -> bool:
        """Return whether every scene had another rig."""
        return self.road_z_m is None

    def width_for(self, rig: Rig) -> int:
        """Return the width, px, at which images of a rig have about as many pixels as those of the training."""
        width, height = self.image_size
        camera = rig.cameras[0]
        return round((width * height * camera.width / camera.height) ** 0.5)

    @property
    def image_size(self) -> tuple[int, int]:
        """Return width and height of the first camera's images, px."""
        return self.rig.cameras[0].width, self.rig.cameras[0].height


def training_data(path: Path, cfg: DictConfig) -> TrainingData:
    """Return what the data source in `cfg`, the configuration of the checkpoint at `path`, tells about its data.

    Raises:
        UserError: when the source cannot be built here, needs scenes that are not there, or has other classes.
    """
    return facts_of(open_data(path, cfg), cfg)


def facts_of(data: OccupancyData, cfg: DictConfig) -> TrainingData:
    """Return what data tells about itself; `cfg` is the configuration that it was built from.

    Raises:
        UserError: when its source needs scenes that are not there.
    """
    source, spec = data.source, data.spec
    name = OmegaConf.select(cfg, "data.source.rig") or "that of recorded scenes"
    return TrainingData(training_rig(source), name, spec.road_z_m, spec.classes, data.unknown, spec.frame_interval_s)


def open_data(path: Path, cfg: DictConfig) -> OccupancyData:
    """Return the data that `cfg`, the configuration of the checkpoint at `path`, describes; nothing is read or made.

    Raises:
        UserError: as `training_data`.
    """
    if "data" not in cfg:
        raise UserError(f"{path} is of another version: its configuration has no data")
    check_parts(path, cfg, ["data"])
    data: OccupancyData = build(cfg.data)
    data.check_classes()
    return data
