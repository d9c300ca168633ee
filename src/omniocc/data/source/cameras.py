"""What is known of a source's training frames, also of one whose scenes are not there yet."""

from omniocc.camera import Rig
from omniocc.data.source import MadeScenes, SceneSource, Split
from omniocc.errors import UserError


def training_rig(source: SceneSource) -> Rig:
    """Return the cameras of a source's training frames, those of the first one if they differ.

    Raises:
        UserError: when there are no training scenes.
    """
    if isinstance(source, MadeScenes):
        return source.planned_rig()
    rig = getattr(source, "rig", None)  # of sources whose scenes all have the same cameras
    return first_rig(source) if rig is None else rig


def first_rig(source: SceneSource) -> Rig:
    """Return the cameras of the first training frame; raise UserError when there are no training scenes."""
    if not (scenes := source.scenes("train")):
        raise UserError("this data has no training scenes, whose cameras are needed")
    return scenes[0].rigs[0]


def frames_in(source: SceneSource, split: Split) -> int:
    """Return the number of a source's frames in a split."""
    if isinstance(source, MadeScenes):
        return sum(source.planned(split).values())
    return sum(map(len, source.scenes(split)))


def training_frames(source: SceneSource) -> int:
    """Return the number of a source's training frames."""
    return frames_in(source, "train")
