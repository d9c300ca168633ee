"""Where pictures come from: a folder of a user's own, or a recorded scene with its truth."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from difflib import get_close_matches
from pathlib import Path
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
import torch
from jaxtyping import Bool, Float32, Float64, UInt8
from torch import Tensor

from omniocc.camera import Rig
from omniocc.data import SceneReader
from omniocc.data.labels.voxels import vote
from omniocc.data.source import Unknown
from omniocc.data.store.shard import META
from omniocc.errors import UserError
from omniocc.geometry import Grid
from omniocc.predict.input.images import Frame, read_frame


class Truth(NamedTuple):
    """What was recorded of a moment beside its pictures; see `omniocc.batch.Batch`."""

    voxels: UInt8[Tensor, "X Y Z"]
    lidar_range_m: Float32[Tensor, " R"]
    lidar_labels: UInt8[Tensor, " R"]
    scored: Bool[Tensor, "X Y Z"] | None = None
    lidar_directions: Float32[Tensor, "R 3"] | None = None
    lidar_origins: Float32[Tensor, "R 3"] | None = None

    def as_batch(self) -> "Truth":
        """Return the same with a first axis of length 1, as `omniocc.task.Scores` takes it."""
        return Truth(self.voxels[None], self.lidar_range_m[None], self.lidar_labels[None])


@runtime_checkable
class Drive(Protocol):
    """Moments in the order of time."""

    @property
    def name(self) -> str:
        """Of the folder of its results in that of all; empty for none."""
        ...

    @property
    def rig(self) -> Rig:
        """The cameras."""
        ...

    @property
    def moments(self) -> tuple[str, ...]:
        """Their names."""
        ...

    @property
    def wanted(self) -> tuple[int, ...]:
        """Numbers of those that are to be predicted; the others serve as history."""
        ...

    @property
    def world_from_ego(self) -> Float64[Tensor, "F 4 4"] | None:
        """Pose of every moment, None if they are not known."""
        ...

    @property
    def origin_z_m(self) -> float:
        """Height of the origin of rig and poses in the frame of their files, in which answers are written."""
        ...

    def images(self, moment: int) -> list[np.ndarray]:
        """(H, W, 3) uint8 RGB of every camera."""
        ...

    def truth(self, moment: int, geometry: Grid, unknown: Unknown) -> Truth | None:
        """What is known of a moment, None if nothing is."""
        ...

    def true_range_m(self, moment: int) -> Float32[Tensor, "1 h w"] | None:
        """The recorded panorama of range, None if there is none."""
        ...


@dataclass(frozen=True)
class PictureDrive:
    """Files of a user's own; see `omniocc.predict.find_frames`."""

    rig: Rig
    frames: tuple[Frame, ...]
    world_from_ego: Float64[Tensor, "F 4 4"] | None
    origin_z_m: float = 0.0
    name: str = ""

    def raised(self, height_m: float) -> "PictureDrive":
        """The same drive around an origin that lies higher by so much."""
        poses = self.rig.ego_from_camera.clone()
        poses[:, 2, 3] -= height_m
        world_from_ego = None if self.world_from_ego is None else moved_origin(self.world_from_ego, height_m)
        rig = Rig(self.rig.cameras, poses, self.rig.names, self.rig.masks)
        return replace(self, rig=rig, world_from_ego=world_from_ego, origin_z_m=self.origin_z_m + height_m)

    @property
    def moments(self) -> tuple[str, ...]:  # noqa: D102
        return tuple(frame.name for frame in self.frames)

    @property
    def wanted(self) -> tuple[int, ...]:
        """All of them."""
        return tuple(range(len(self.frames)))

    def images(self, moment: int) -> list[np.ndarray]:  # noqa: D102
        return read_frame(self.frames[moment], self.rig)

    def truth(self, moment: int, geometry: Grid, unknown: Unknown) -> None:
        """Nobody knows."""

    def true_range_m(self, moment: int) -> None:
        """Nobody knows."""


@dataclass(frozen=True)
class RecordedDrive:
    """A recorded scene.

    Attributes:
        scene: where it lies.
        wanted: numbers of the frames that are to be predicted.
    """

    scene: SceneReader
    wanted: tuple[int, ...]

    @property
    def name(self) -> str:  # noqa: D102
        return self.scene.name

    @property
    def rig(self) -> Rig:  # noqa: D102
        return self.scene.rig

    @property
    def origin_z_m(self) -> float:  # noqa: D102
        return 0.0

    @property
    def moments(self) -> tuple[str, ...]:  # noqa: D102
        return tuple(moment_name(frame) for frame in range(len(self.scene)))

    @property
    def world_from_ego(self) -> Float64[Tensor, "F 4 4"]:  # noqa: D102
        return torch.from_numpy(self.scene.world_from_ego)

    def images(self, moment: int) -> list[np.ndarray]:  # noqa: D102
        return self.scene.images(moment)

    def truth(self, moment: int, geometry: Grid, unknown: Unknown) -> Truth:  # noqa: D102
        scan = self.scene.lidar(moment)
        voxels = vote(self.scene, moment, geometry, unknown)
        return Truth(voxels, torch.from_numpy(scan.range_m), torch.from_numpy(scan.labels))

    def true_range_m(self, moment: int) -> Float32[Tensor, "1 h w"]:  # noqa: D102
        return torch.from_numpy(self.scene.erp_range_m(moment)).unsqueeze(0)


def moved_origin(world_from_ego: Float64[Tensor, "*F 4 4"], height_m: float) -> Float64[Tensor, "*F 4 4"]:
    """Poses of an origin that lies higher in the ego frame."""
    moved = world_from_ego.clone()
    moved[..., :3, 3] += height_m * world_from_ego[..., :3, 2]
    return moved


def moment_name(frame: int) -> str:
    """Of a recorded frame."""
    return f"{frame:06d}"


def find_scenes(data: Path, scene: str | None, frames: Sequence[int] | None) -> list[RecordedDrive]:
    """Recorded scenes to be predicted.

    Args:
        data: a scene's folder, or a dataset's, which holds those of scenes.
        scene: name of one of a dataset; None: all of its test.
        frames: numbers of the frames that are wanted; None: all.

    Raises:
        UserError: naming what is not there, and what is.
        DataError: when a scene is damaged.
    """
    if (data / META).is_file():
        found = [data]
    else:
        folders = (path.parent for path in data.glob(f"*/{META}"))
        names = sorted(folder.name for folder in folders if folder.suffix != ".partial")
        found = [data / name for name in _chosen(data, names, scene)]
    return [_drive(SceneReader(folder), frames) for folder in found]


def _chosen(data: Path, names: list[str], scene: str | None) -> list[str]:
    if not names:
        what = "holds no recorded scenes" if data.is_dir() else "is no folder"
        raise UserError(f"recorded={data} {what}; give a dataset (data/virtual-<hash>) or one of its scenes")
    if scene is None:
        test = [name for name in names if name.startswith("test-")]
        if not test:
            raise UserError(f"recorded={data} holds no scenes of the test; choose one: scene={names[0]}")
        return test
    if scene not in names:
        close = get_close_matches(scene, names, n=1)
        hint = f"did you mean '{close[0]}'?" if close else f"there are {len(names)}, such as {', '.join(names[:3])}"
        raise UserError(f"scene={scene}: there is no such scene in {data}; {hint}")
    return [scene]


def _drive(scene: SceneReader, frames: Sequence[int] | None) -> RecordedDrive:
    wanted = range(len(scene)) if frames is None else sorted(set(frames))
    for frame in wanted:
        if not 0 <= frame < len(scene):
            raise UserError(f"frames={list(wanted)}: scene '{scene.name}' has the frames 0 to {len(scene) - 1}")
    return RecordedDrive(scene, tuple(wanted))
