"""What is known of the data that a model was trained on, and how another rig compares with it."""

from dataclasses import dataclass, replace

from omegaconf import DictConfig, OmegaConf

from omniocc.camera import Rig
from omniocc.classes import ClassTable
from omniocc.data import OccupancyData
from omniocc.data.source import Ignore
from omniocc.data.source.cameras import training_rig
from omniocc.data.store.meta import DRAWN_RIGS
from omniocc.predict.road import NO_ROAD

UNMOVED_M = 0.0005
"""Distance that an origin may move without a word."""


@dataclass(frozen=True)
class TrainingData:
    """The data that a model was trained on.

    Attributes:
        rig: its cameras, at the size of its images; those of its first frame, if they differ.
        rig_name: name or file of the rig, `random`, or a phrase where scenes are recorded.
        road_z_m: height of the road in its ego frame, m; None: another one in every scene, as with drawn rigs.
        classes: table of the model's classes.
        ignore: which true cells are unknown.
        frame_interval_s: time between frames, and so the age of the newest past one, s.
    """

    rig: Rig
    rig_name: str
    road_z_m: float | None
    classes: ClassTable
    ignore: Ignore
    frame_interval_s: float

    @classmethod
    def of(cls, data: OccupancyData, cfg: DictConfig) -> "TrainingData":
        """Return what data tells about itself; `cfg` is the configuration that it was built from.

        Raises:
            UserError: when its source needs scenes that are not there.
        """
        source, spec = data.source, data.spec
        name = OmegaConf.select(cfg, "data.source.rig") or "that of recorded scenes"
        return cls(training_rig(source), name, spec.road_z_m, spec.classes, data.ignore, spec.frame_interval_s)

    def width_for(self, rig: Rig) -> int:
        """Return the width, px, at which images of a rig have about as many pixels as those of the training."""
        width, height = self.image_size
        camera = rig.cameras[0]
        return round((width * height * camera.width / camera.height) ** 0.5)

    @property
    def image_size(self) -> tuple[int, int]:
        """Return width and height of the first camera's images, px."""
        return self.rig.cameras[0].width, self.rig.cameras[0].height

    def has(self, rig: Rig) -> bool:
        """Return whether the cameras are those of the training, at any size; the height of the road does not count."""
        try:
            scaled = rig.resized(*self.image_size)
        except ValueError:  # a lens cannot be brought to that size
            return False
        return replace(scaled, road_z_m=self.rig.road_z_m) == self.rig

    def compare(self, rig: Rig) -> str:
        """Return in words whether the model was trained with this rig."""
        if self.rig_name in DRAWN_RIGS:
            return "the weights are for any rig"
        return (
            "as in training" if self.has(rig) else f"not those of the training ({self.rig_name}): expect worse results"
        )

    def place(self, rig: Rig) -> tuple[Rig, float, str]:
        """Return a rig with its origin as high above the road as in training, by how much that is higher, m, and why.

        The reason is a line for the user, empty where nothing is to be said. The origin stays where the height of the
        road is not known here or in the training.
        """
        here_m, there_m, height_m, line = rig.road_z_m, self.road_z_m, 0.0, ""
        if here_m is None and self.has(rig):
            return rig, 0.0, ""
        if here_m is None and there_m is None:
            line = NO_ROAD
        elif there_m is None:
            line = "at another height for every rig of the training: the grid stays around the origin of the rig"
        elif here_m is None:
            line = f"its height is not known (road_z_m): taken for {there_m:g} m, as in training; "
            line += "state it in the rig file, or as road_z_m=..."
        elif abs(height_m := round(here_m - there_m, 6)) >= UNMOVED_M:
            moved = f"{abs(height_m):.3g} m {'higher' if height_m > 0 else 'lower'}"
            line = (
                f"{-here_m:g} m below the origin of the rig (its road_z_m), {-there_m:g} m in the training: the grid "
            )
            line += f"lies {moved}; if that is wrong, correct road_z_m"
        return rig.raised(height_m) if height_m else rig, height_m, line
