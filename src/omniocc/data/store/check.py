"""Check a dataset: every byte against its checksum, every frame against the one before."""

import hashlib
import tarfile
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from omniocc.classes import NUM_CLASSES
from omniocc.data.formats.poses import jumps, not_rigid
from omniocc.data.labels.voxels import vote
from omniocc.data.spacing import evenly_spaced
from omniocc.data.store.codec import POINTS, decode_frame
from omniocc.data.store.reader import SceneReader
from omniocc.data.store.shard import INDEX, member_name, shard_name
from omniocc.errors import DataError
from omniocc.geometry import Grid
from omniocc.parallel import mapped
from rayiou.labels import ids_beyond

MAX_SPEED_MPS = 25.0
MAX_TURN_DEG_PER_S = 120.0
TIME_TOLERANCE_S = 1e-6


class Survey(NamedTuple):
    """The result of reading a scene back.

    Attributes:
        problems: one line each.
        voxels: (C,) cells of each class over the frames that were decoded.
    """

    problems: list[str]
    voxels: np.ndarray


def survey_scene(frames: int, interval_s: float, geometry: Grid, decoded: int, scene: SceneReader) -> Survey:
    """Return the problems of a scene, and its classes.

    Args:
        frames: how many it should hold.
        interval_s: time between them.
        geometry: grid in which classes are counted.
        decoded: frames that are decoded and counted; bytes, times and poses are checked in all.
        scene: to be checked.
    """
    problems = check_scene(scene, frames, interval_s)
    voxels = np.zeros(NUM_CLASSES, dtype=np.int64)
    if not problems:
        chosen = evenly_spaced(len(scene), decoded)
        problems = [line for frame in chosen for line in _content(scene, frame)]
        if scene.has(POINTS):
            for frame in chosen:
                voxels += np.bincount(vote(scene, frame, geometry).flatten(), minlength=256)[:NUM_CLASSES]
    return Survey(problems, voxels)


def check_scene(scene: SceneReader, num_frames: int, interval_s: float) -> list[str]:
    """Return the problems of a scene's files, times and poses, one line each."""
    try:
        return [*_files(scene), *_frames(scene, num_frames), *_times(scene, interval_s), *_poses(scene)]
    except DataError as error:
        return [str(error)]


def _files(scene: SceneReader) -> Iterator[str]:
    for name, facts in scene.meta["files"].items():
        try:
            size = scene.files.size(name)
            if size != facts["size"]:
                yield str(scene.damaged(name, f"{size} bytes instead of {facts['size']}"))
            elif name != INDEX:
                with scene.files.open(name) as file:
                    if hashlib.file_digest(file, "sha256").hexdigest() != facts["sha256"]:
                        yield str(scene.damaged(name, "its checksum differs"))
        except FileNotFoundError:
            yield str(scene.damaged(name, "the file is missing"))
        except Exception as error:  # each kind of store has errors of its own
            yield str(scene.unreadable(name, error))


def _frames(scene: SceneReader, num_frames: int) -> Iterator[str]:
    numbers, members = scene.index.shard.tolist(), scene.index.members
    if not len(scene) == len(numbers) == num_frames:
        yield str(scene.damaged(INDEX, f"{len(numbers)} frames instead of {num_frames}"))
    shards = sorted({shard_name(number) for number in numbers})
    existing = {name for name in shards if _exists(scene, name)}
    for frame, number in enumerate(numbers):
        try:
            if shard_name(number) in existing:
                scene.read(frame, members)
        except DataError as error:
            yield str(error)
    names = [member_name(frame, member) for frame in range(len(numbers)) for member in members]
    try:
        if len(existing) == len(shards) and list(_tar_names(scene, shards)) != names:
            yield str(scene.damaged(shards[0], "the shards do not list all members in order"))
    except (tarfile.TarError, OSError) as error:
        yield str(scene.damaged(shards[0], f"a shard is no valid tar file ({error})"))


def _exists(scene: SceneReader, name: str) -> bool:
    try:
        return scene.files.size(name) >= 0
    except FileNotFoundError:
        return False


def _tar_names(scene: SceneReader, shards: list[str]) -> Iterator[str]:
    for name in shards:
        with scene.files.open(name) as file, tarfile.open(fileobj=file) as tar:
            yield from tar.getnames()


def _times(scene: SceneReader, interval_s: float) -> Iterator[str]:
    expected_s = np.arange(len(scene.time_s)) * interval_s
    off = np.flatnonzero(np.abs(scene.time_s - expected_s) > TIME_TOLERANCE_S)
    if len(off):
        first = int(off[0])
        times = f"{scene.time_s[first]:g} s instead of {expected_s[first]:g} s"
        problem = f"its time is {times} ({len(off)} frames are off)"
        yield str(scene.damaged(INDEX, problem, first))


def _poses(scene: SceneReader) -> Iterator[str]:
    poses = scene.world_from_ego
    bad = np.flatnonzero(not_rigid(poses))
    if len(bad):
        yield str(scene.damaged(INDEX, "its pose is no rotation and shift", int(bad[0])))
        return
    for frame, problem in jumps(poses, scene.time_s, MAX_SPEED_MPS, MAX_TURN_DEG_PER_S):
        yield str(scene.damaged(INDEX, problem, frame))


def _content(scene: SceneReader, frame: int) -> Iterator[str]:
    shard = shard_name(int(scene.index.shard[frame]))
    try:
        recorded = decode_frame(scene.read(frame, scene.index.members))
    except Exception as error:  # decoders raise errors of many kinds
        yield str(scene.damaged(shard, f"it cannot be decoded ({type(error).__name__}: {error})", frame))
        return
    sizes = [(camera.height, camera.width) for camera in scene.rig.cameras]
    arrays = {"images": recorded.images, "semantics": recorded.semantics, "ranges": recorded.range_m}
    for name, array in arrays.items():
        if array is None:
            continue
        shape = array.shape[:3]
        if shape != (len(sizes), *sizes[0]):
            yield str(scene.damaged(shard, f"{name} have the shape {shape}, those of the rig are {sizes}", frame))
    for name, labels, least in (("pixels", recorded.semantics, 0), ("points", recorded.point_labels, 1)):
        wrong = [] if labels is None else ids_beyond(labels, NUM_CLASSES, least)
        if wrong:
            yield str(scene.damaged(shard, f"{name} of classes {wrong}, which do not exist", frame))
    if not np.array_equal(recorded.world_from_ego, scene.world_from_ego[frame]):
        yield str(scene.damaged(shard, "frame.json and the index give different poses", frame))


def survey(work: Callable[[SceneReader], Survey], scenes: Sequence[SceneReader], workers: int) -> list[Survey]:
    """Check scenes side by side; `work` must be picklable."""
    return list(mapped(work, scenes, workers))
