"""From where the rays of RayIoU start: the dataset's own protocol, the ego origin, or where the car was."""

from typing import Literal

from omniocc.data.source import SceneFrames
from omniocc.geometry import Grid
from rayiou.directions import RayOrigins, trajectory_origins

Origins = Literal["own", "ego", "trajectory"]
"""`own`: those of the dataset's protocol, else the ego origin; `ego`: the ego origin of the scored frame; `trajectory`:
where the car was in past, present and future frames (those of the dataset's protocol, if it has them)."""


def scene_origins(scene: SceneFrames, frame: int, grid: Grid) -> RayOrigins:
    """Return where the ego origin was before, at and after a frame, by the rule of the public RayIoU.

    Of all recorded frames of the scene, at most eight whose ego origin lies more than 1 m inside of the grid's sides;
    see `rayiou.directions.trajectory_origins` for the rule and its source.

    Args:
        scene: with the pose of every frame.
        frame: number of the scored frame.
        grid: that is scored.
    """
    return trajectory_origins(scene.world_from_ego, frame, grid)


def choose_origins(
    origins: Origins, own: RayOrigins | None, scene: SceneFrames, frame: int, grid: Grid | None
) -> RayOrigins | None:
    """Return where the rays of a frame start; None: in the ego origin.

    Args:
        origins: the choice.
        own: those of the dataset's protocol.
        scene: as in `scene_origins`.
        frame: as in `scene_origins`.
        grid: as in `scene_origins`; only needed by `trajectory`.
    """
    if origins == "ego":
        return None
    if origins == "trajectory" and own is None:
        assert grid is not None
        return scene_origins(scene, frame, grid)
    return own
