"""Reading a dataset back: every byte compared with its checksum, every frame with what comes before it."""

import tarfile
from collections.abc import Iterator

import numpy as np

from omniocc.data.errors import DataError
from omniocc.data.reader import SceneReader
from omniocc.data.shard import INDEX, member_name, sha256, shard_name


def check_scene(scene: SceneReader, num_frames: int) -> list[str]:
    """All that is wrong with a scene, one line each; empty when it is whole.

    Args:
        scene: a folder of recorded frames.
        num_frames: how many it should hold.
    """
    try:
        return [*_files(scene), *_frames(scene, num_frames)]
    except DataError as error:
        return [str(error)]


def _files(scene: SceneReader) -> Iterator[str]:
    for name, facts in scene.meta["files"].items():
        path = scene.folder / name
        if not path.is_file():
            yield str(scene.damaged(path, "the file is missing"))
        elif path.stat().st_size != facts["size"]:
            yield str(scene.damaged(path, f"{path.stat().st_size} bytes instead of {facts['size']}"))
        elif sha256(path) != facts["sha256"] and name != INDEX:
            yield str(scene.damaged(path, "its checksum differs"))


def _frames(scene: SceneReader, num_frames: int) -> Iterator[str]:
    records, members = scene.index["frames"], scene.index["members"]
    if not len(scene) == len(records) == num_frames:
        yield str(scene.damaged(scene.folder, f"{len(records)} frames instead of {num_frames}"))
    there = [(scene.folder / shard_name(record["shard"])).is_file() for record in records]
    for frame in np.flatnonzero(there).tolist():
        yield from _members(scene, frame, members)
    steps_s = np.diff(scene.time_s)
    if np.any(steps_s <= 0):
        yield str(scene.damaged(scene.folder / INDEX, "time does not go forward", int(np.argmax(steps_s <= 0)) + 1))
    names = [member_name(frame, member) for frame in range(len(records)) for member in members]
    try:
        if all(there) and list(_tar_names(scene)) != names:
            yield str(scene.damaged(scene.folder, "the shards do not list all members in order"))
    except (tarfile.TarError, OSError) as error:
        yield str(scene.damaged(scene.folder, f"a shard is no valid tar file ({error})"))


def _members(scene: SceneReader, frame: int, members: list[str]) -> Iterator[str]:
    try:
        scene.read(frame, members)
    except DataError as error:
        yield str(error)


def _tar_names(scene: SceneReader) -> Iterator[str]:
    for path in sorted(scene.folder.glob("*.tar")):
        with tarfile.open(path) as tar:
            yield from tar.getnames()
