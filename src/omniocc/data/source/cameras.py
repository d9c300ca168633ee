"""The cameras of a source, also of one whose scenes are not there yet."""

from omniocc.camera import Rig
from omniocc.data.source import SceneSource
from omniocc.data.source.virtual import VirtualWorld
from omniocc.errors import UserError


def training_rig(source: SceneSource) -> Rig:
    """Return the cameras of a source's training frames, those of the first one if they differ.

    Raises:
        UserError: when there are no training scenes.
    """
    if isinstance(source, VirtualWorld):
        return source.rig or source.rig_of(source.plans[0])
    rig = getattr(source, "rig", None)  # of sources whose scenes all have the same cameras
    if rig is not None:
        return rig
    scenes = source.scenes("train")
    if not scenes:
        raise UserError("the model's training data has no training scenes, whose cameras are needed")
    return scenes[0].rigs[0]
