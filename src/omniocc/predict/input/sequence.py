"""Sequences of frames to predict: a user's own images, or a recorded scene with its ground truth."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from difflib import get_close_matches
from pathlib import Path
from typing import ClassVar, NamedTuple

import numpy as np
import torch
from jaxtyping import Float32, Float64, UInt8
from torch import Tensor

from omniocc.batch import Truth
from omniocc.camera import Rig
from omniocc.classes import FREE, OCCUPANCY_CLASSES, UNKNOWN
from omniocc.data import SceneReader
from omniocc.data.source import Ignore, SceneFrames, SourceSpec
from omniocc.data.source.recorded import spec_of, votes_of
from omniocc.data.store.codec import POINTS
from omniocc.data.store.shard import META
from omniocc.errors import UserError
from omniocc.geometry import Grid
from omniocc.predict.input.images import FrameFiles, check_excluded, read_frame

EGO = "ego"
"""Name of the ego frame where no other program has given it one."""


class Mount(NamedTuple):
    """Where the ego frame is for programs of ROS.

    Attributes:
        frame: their name of the ego frame.
        base: name of the frame that it is fixed to; None: it is fixed to none.
        base_from_ego: its pose there.
    """

    frame: str = EGO
    base: str | None = None
    base_from_ego: Float64[np.ndarray, "4 4"] | None = None


ALONE = Mount()


@dataclass(frozen=True)
class ImageSequence:
    """A user's own images in the order of time: files (`of_files`), or a ROS bag (`omniocc.predict.input.bags`).

    Attributes:
        rig: the cameras.
        frame_names: the name of every frame.
        read: returns (H, W, 3) uint8 RGB of every camera of the rig, by the number of the frame.
        world_from_ego: pose of every frame, None if poses are unknown.
        stamps_ns: time of every frame, ns.
        mount: see `Mount`.
        topics: of the images of each camera in a bag; None for files.
        origin_z_m: height of the ego origin in the frame of the rig file, in which predictions are written.
        name: of the folder that the results of this sequence go to; empty: the output folder itself.
    """

    rig: Rig
    frame_names: tuple[str, ...]
    read: Callable[[int], list[np.ndarray]]
    world_from_ego: Float64[Tensor, "F 4 4"] | None
    stamps_ns: tuple[int, ...]
    mount: Mount = ALONE
    topics: Mapping[str, str] | None = None
    origin_z_m: float = 0.0
    name: str = ""

    @classmethod
    def of_files(cls, rig: Rig, frames: Sequence[FrameFiles]) -> "ImageSequence":
        """Return the sequence of image files, see `omniocc.predict.find_frames`; its times are their numbers, s."""
        stamps_ns = tuple(frame * 10**9 for frame in range(len(frames)))
        names = tuple(frame.name for frame in frames)
        return cls(rig, names, lambda frame: read_frame(frames[frame], rig), None, stamps_ns)

    def raise_origin(self, height_m: float) -> "ImageSequence":
        """Return the same sequence with its ego origin `height_m` higher."""
        world_from_ego = None if self.world_from_ego is None else raise_poses(self.world_from_ego, height_m)
        rig = self.rig.raised(height_m)
        return replace(self, rig=rig, world_from_ego=world_from_ego, origin_z_m=self.origin_z_m + height_m)

    @property
    def wanted(self) -> tuple[int, ...]:
        """Return the indices of the frames to be predicted: all."""
        return tuple(range(len(self.frame_names)))

    def images(self, frame: int) -> list[np.ndarray]:
        """Return (H, W, 3) uint8 RGB of every camera."""
        return self.read(frame)

    def truth(self, frame: int, geometry: Grid, ignore: Ignore) -> None:
        """Return None: no ground truth is available."""

    def true_range_m(self, frame: int) -> None:
        """Return None: no ground truth is available."""


@dataclass(frozen=True)
class RecordedSequence:
    """A recorded scene, with what `ImageSequence` has except `read`, `topics`, `of_files` and `raise_origin`.

    Attributes:
        scene: reader of its files.
        wanted: indices of the frames to be predicted; the others serve as history.
        merged: whether all classes of the ground truth but free count as one, as for a network without classes.
    """

    scene: SceneReader
    wanted: tuple[int, ...]
    merged: bool = False
    origin_z_m: ClassVar[float] = 0.0
    mount: ClassVar[Mount] = ALONE

    @property
    def stamps_ns(self) -> tuple[int, ...]:
        """Return the time of every frame, ns."""
        return tuple(round(time_s * 1e9) for time_s in self.scene.time_s)

    @property
    def name(self) -> str:
        """Return the name of the scene, and of the folder that its results go to."""
        return self.scene.name

    @property
    def rig(self) -> Rig:
        """Return the cameras."""
        return self.scene.rig

    @property
    def spec(self) -> SourceSpec:
        """Return the classes and bands that the scene states; raise DataError when it states none."""
        spec = spec_of(self.scene)
        return replace(spec, classes=OCCUPANCY_CLASSES) if self.merged else spec

    @property
    def road_z_m(self) -> float | None:
        """Return the height of the road that the rig states, or the scene with its classes, m; None without both."""
        return self.spec.road_of(self.rig) if self.labelled else self.rig.road_z_m

    @property
    def frame_names(self) -> tuple[str, ...]:
        """Return the name of every frame: its number."""
        return tuple(map(frame_name, range(len(self.scene))))

    @property
    def world_from_ego(self) -> Float64[Tensor, "F 4 4"]:
        """Return the pose of every frame."""
        return torch.from_numpy(self.scene.world_from_ego)

    def images(self, frame: int) -> list[np.ndarray]:
        """Return (H, W, 3) uint8 RGB of every camera."""
        return self.scene.images(frame)

    @property
    def labelled(self) -> bool:
        """Return whether the scene has points, from which the true voxels are voted."""
        return self.scene.has(POINTS)

    def truth(self, frame: int, geometry: Grid, ignore: Ignore) -> Truth | None:
        """Return the ground truth of a frame; None if the scene has no points."""
        if not self.labelled:
            return None
        scan = self.scene.lidar(frame)
        voxels = self._classes(votes_of(self.scene, geometry, ignore).read(self.scene, frame))[None]
        if scan is None:
            return Truth(voxels)
        labels = self._classes(torch.from_numpy(scan.labels))[None]
        return Truth(voxels, torch.from_numpy(scan.range_m)[None], labels)

    def _classes(self, labels: UInt8[Tensor, "..."]) -> UInt8[Tensor, "..."]:
        occupied = (labels != FREE) & (labels != UNKNOWN)
        return labels.masked_fill(occupied, OCCUPANCY_CLASSES.occupied[0]) if self.merged else labels

    def true_range_m(self, frame: int) -> Float32[Tensor, "1 h w"] | None:
        """Return the recorded panorama of range; None without one."""
        return true_range_m(self.scene, frame)


FrameSequence = ImageSequence | RecordedSequence
"""Frames of one rig in the order of time."""


def frame_name(frame: int) -> str:
    """Return the name of a recorded frame: its number."""
    return f"{frame:06d}"


def true_range_m(scene: SceneFrames, frame: int) -> Float32[Tensor, "1 h w"] | None:
    """Return the recorded panorama of range of a frame, m; None without one."""
    range_m = scene.erp_range_m(frame)
    return None if range_m is None else torch.from_numpy(range_m).unsqueeze(0)


def with_road(rig: Rig, road_z_m: float | None) -> Rig:
    """Return a rig with another height of the road, m; None: with its own.

    Raises:
        UserError: when the road is not below the ego origin.
    """
    try:
        return rig if road_z_m is None else replace(rig, road_z_m=road_z_m)
    except (ValueError, TypeError) as error:
        raise UserError(f"road_z_m={road_z_m}: it must be a height below 0, m, such as -0.9") from error


def raise_poses(world_from_ego: Float64[Tensor, "*F 4 4"], height_m: float) -> Float64[Tensor, "*F 4 4"]:
    """Return the poses of an ego origin that lies `height_m` higher, along the ego frame's z axis."""
    raised = world_from_ego.clone()
    raised[..., :3, 3] += height_m * world_from_ego[..., :3, 2]
    return raised


def find_scenes(
    data: Path, scene: str | None, frames: Sequence[int] | None, excluded: Sequence[str] = ()
) -> list[RecordedSequence]:
    """Return the recorded scenes to be predicted.

    Args:
        data: folder of one scene, or of a dataset, which holds the folders of its scenes.
        scene: name of one scene of a dataset; None: all test scenes.
        frames: indices of the wanted frames; None: all.
        excluded: names of the cameras to leave out.

    Raises:
        UserError: naming what does not exist, and what does.
        DataError: when a scene is damaged.
    """
    if (data / META).is_file():
        found = [data]
    else:
        folders = (path.parent for path in data.glob(f"*/{META}"))
        names = sorted(folder.name for folder in folders if folder.suffix != ".partial")
        found = [data / name for name in _chosen(data, names, scene)]
    scenes = [SceneReader(folder) for folder in found]
    sequences = [RecordedSequence(one, chosen_frames(one.name, len(one), frames)) for one in scenes]
    for sequence in sequences:
        check_excluded(excluded, sequence.rig)
    return sequences


def _chosen(data: Path, names: list[str], scene: str | None) -> list[str]:
    if not names:
        problem = "holds no recorded scenes" if data.is_dir() else "is not a folder"
        raise UserError(f"recorded={data} {problem}; give a dataset (data/virtual-<hash>) or one of its scenes")
    if scene is None:
        test = [name for name in names if name.startswith("test-")]
        if not test:
            raise UserError(f"recorded={data} holds no test scenes; choose one scene: scene={names[0]}")
        return test
    check_scene(scene, names, str(data))
    return [scene]


def check_scene(scene: str, names: Sequence[str], where: str) -> None:
    """Raise UserError, which says where scenes were sought and what is there, unless a scene is one of `names`."""
    if scene not in names:
        close = get_close_matches(scene, names, n=1)
        hint = f"did you mean '{close[0]}'?" if close else f"there are {len(names)}, such as {', '.join(names[:3])}"
        raise UserError(f"scene={scene}: there is no such scene in {where}; {hint}")


def chosen_frames(scene: str, length: int, frames: Sequence[int] | None) -> tuple[int, ...]:
    """Return the indices of the wanted frames of a scene, each once and in order; None: of all.

    Raises:
        UserError: naming the scene and its frames when one of them does not exist.
    """
    wanted = range(length) if frames is None else sorted(set(frames))
    if any(not 0 <= frame < length for frame in wanted):
        raise UserError(f"frames={list(wanted)}: scene '{scene}' has the frames 0 to {length - 1}")
    return tuple(wanted)
