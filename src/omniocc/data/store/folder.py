"""Reading scene folders: any member of any frame by byte offset, every byte checked."""

import hashlib
import zlib
from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float64, Int32, Int64, UInt32

from omniocc.camera import Equirectangular
from omniocc.camera.protocol import pair
from omniocc.data.formats.poses import check_position
from omniocc.data.store.files import LIMIT_BYTES, Files, is_url, named, read_members
from omniocc.data.store.shard import INDEX, META, SCHEMA, digest, shard_name
from omniocc.errors import FAULTS, DataError, reason_of, repr_of
from omniocc.io import checked_name, parse_json, twice

LEAST_FRAME_BYTES = 50
"""Smallest size of a frame's lines in an index."""


class Index(NamedTuple):
    """Where the members of the frames of a scene lie; arrays, since a scene of the paper has 60,000 members.

    Attributes:
        members: names of the members of a frame.
        shard: number of the shard of every frame.
        offset: of every member in its shard, bytes.
        size: of every member, bytes.
        crc32: checksum of every member.
        time_s: of every frame since the scene began; empty for scenes of derived data.
        world_from_ego: ego poses; empty for scenes of derived data.
    """

    members: tuple[str, ...]
    shard: Int32[np.ndarray, " F"]
    offset: Int64[np.ndarray, "F M"]
    size: Int32[np.ndarray, "F M"]
    crc32: UInt32[np.ndarray, "F M"]
    time_s: Float64[np.ndarray, " T"]
    world_from_ego: Float64[np.ndarray, "T 4 4"]


def read_index(plain: Mapping[str, Any]) -> Index:
    """Return the index that `index.json` holds.

    Raises:
        Exception: one of `FAULTS`, if something is missing or impossible.
    """
    frames, members = plain["frames"], tuple(checked_name("the name of a member", name) for name in plain["members"])
    if (name := twice(members)) is not None:
        raise ValueError(f"the member '{name}' stands twice in it")
    entries = [frame["entry"] for frame in frames if frame["entry"]]
    offset, size, crc32 = (
        np.array([frame[key] for frame in frames], dtype).reshape(len(frames), len(members))
        for key, dtype in (("offset", np.int64), ("size", np.int32), ("crc32", np.uint32))
    )
    return Index(
        members,
        np.array([frame["shard"] for frame in frames], np.int32),
        offset,
        size,
        crc32,
        np.array([entry["time_s"] for entry in entries], np.float64),
        world_from_ego=np.array([entry["world_from_ego"] for entry in entries] or np.empty((0, 4, 4)), np.float64),
    )


def check_meta(meta: Mapping[str, Any]) -> None:
    """Check the facts of a scene on which reading depends.

    Raises:
        ValueError: naming the fact and its value: more frames than the index can list, a file without size or sum,
            classes that are no table, or edges of panoramas that are none.
    """
    files, frames = meta.get("files"), meta.get("frames")
    if not isinstance(files, dict) or not isinstance(meta.get("facts"), dict):
        raise ValueError("it has no 'files' or no 'facts'")
    for name, facts in files.items():
        known = isinstance(facts, dict) and isinstance(facts.get("size"), int) and isinstance(facts.get("sha256"), str)
        checked_name("the name of a file", name)
        if not known:
            raise ValueError(f"'files' has an impossible entry '{name}': {repr_of(facts)}")
    listed = min(files.get(INDEX, {"size": 0})["size"], LIMIT_BYTES)
    if not isinstance(frames, int) or isinstance(frames, bool) or not 0 <= frames <= listed // LEAST_FRAME_BYTES:
        most = f"its {INDEX} of {listed:,} bytes can list at most {listed // LEAST_FRAME_BYTES:,}"
        raise ValueError(f"'frames' is {repr_of(frames)}, but {most}")
    if not frames:
        raise ValueError("'frames' is 0; a scene has at least one")
    spec = meta["facts"].get("spec", {})
    if not isinstance(spec, dict) or not isinstance(spec.get("classes", {}), dict):
        raise ValueError(f"'spec' holds no table of classes: {repr_of(spec)}")
    if "panorama_edges_deg" in meta["facts"]:
        top_deg, bottom_deg = pair("'panorama_edges_deg'", meta["facts"]["panorama_edges_deg"])
        Equirectangular(1, 1, top_deg, bottom_deg)  # whose edges it checks


def check_index(index: Index, meta: Mapping[str, Any]) -> None:
    """Check an index against the facts of its scene.

    Raises:
        ValueError: if it lists another number of frames, members outside of their shards, times or poses that are no
            finite numbers, or those of some frames alone, times that run backwards, or a pose beyond the Earth.
    """
    if len(index.shard) != meta["frames"]:
        raise ValueError(f"{len(index.shard)} frames instead of {meta['frames']}")
    sizes = {int(number): meta["files"].get(shard_name(number), {"size": 0})["size"] for number in set(index.shard)}
    for frame, number in enumerate(index.shard.tolist()):
        offset, size = index.offset[frame], index.size[frame]
        if min(offset.min(initial=0), size.min(initial=0)) < 0 or (offset + size).max(initial=0) > sizes[number]:
            raise ValueError(f"frame {frame} has members outside of {shard_name(number)}, of {sizes[number]:,} bytes")
    times, poses = index.time_s, index.world_from_ego
    if len(times) not in (0, len(index.shard)) or times.ndim != 1 or poses.shape != (len(times), 4, 4):
        shapes = f"times of the shape {times.shape}, poses of the shape {poses.shape}"
        raise ValueError(f"{len(index.shard)} frames, but {shapes}")
    wrong = np.flatnonzero(~(np.isfinite(times) & np.isfinite(poses).all(axis=(1, 2))))
    if len(wrong):
        raise ValueError(f"time or pose of frame {wrong[0]} holds a value that is not finite")
    if len(wrong := np.flatnonzero(np.diff(times) < 0)):
        raise ValueError(f"the time runs backwards from frame {wrong[0]} to {wrong[0] + 1}")
    check_position(poses[:, :3, 3], "a pose")


class SceneFolder:
    """The files of a complete scene, opened only to be read; picklable.

    Args:
        folder: the scene's folder, or its URL in an object store (memory://, http://, s3:// ...).

    Raises:
        DataError: from every method, when something is missing or damaged; names the file, scene, frame and member.
    """

    def __init__(self, folder: Path | str):
        self.folder = str(folder).rstrip("/") if is_url(folder) else Path(folder)

    @property
    def name(self) -> str:
        """Return the scene's name."""
        return self.folder.rsplit("/", 1)[-1] if isinstance(self.folder, str) else self.folder.name

    @cached_property
    def files(self) -> Files:
        """Return the scene's files."""
        return Files(self.folder)

    @cached_property
    def meta(self) -> dict[str, Any]:
        """Return schema, facts of the scene and checksums of its files."""
        meta = self._json(META, self._content(META))
        claimed = meta.pop("digest", None)
        if digest(meta) != claimed:
            raise self.damaged(META, "its checksum differs")
        if meta.get("schema") != SCHEMA:
            raise self.damaged(META, f"schema {meta.get('schema')}, this version reads {SCHEMA}")
        try:
            check_meta(meta)
        except FAULTS as error:
            raise self.damaged(META, reason_of(error)) from error
        return meta

    @cached_property
    def index(self) -> Index:
        """Return where every member of every frame lies."""
        plain = self._json(INDEX, self.checked(INDEX))
        try:
            index = read_index(plain)
            check_index(index, self.meta)
        except FAULTS as error:
            raise self.damaged(INDEX, f"it is no index of this scene ({error!r})") from error
        return index

    def __len__(self) -> int:
        return self.meta["frames"]

    def read(self, frame: int, members: Sequence[str]) -> dict[str, bytes]:
        """Return the named members of one frame, each compared with its checksum."""
        index, shard = self.index, shard_name(int(self.index.shard[frame]))
        columns = [self._column(member) for member in members]
        offsets, sizes = (part[frame, columns].tolist() for part in (index.offset, index.size))
        try:
            blobs = read_members(self.files, shard, offsets, sizes)
        except FileNotFoundError as error:
            raise self.damaged(shard, "the file is missing", frame, members[0]) from error
        except Exception as error:  # each kind of store has errors of its own
            raise self.unreadable(shard, error) from error
        for member, column, blob in zip(members, columns, blobs, strict=True):
            if len(blob) != index.size[frame, column]:
                raise self.damaged(shard, "the file is cut short", frame, member)
            if zlib.crc32(blob) != index.crc32[frame, column]:
                raise self.damaged(shard, "checksum differs", frame, member)
        return dict(zip(members, blobs, strict=True))

    def damaged(self, name: str, problem: str, frame: int | None = None, member: str | None = None) -> DataError:
        """Return the error for a damaged file of the scene; it names file, scene, frame, member and remedy."""
        where = f", frame {frame}" if frame is not None else ""
        where += f", member '{member}'" if member is not None else ""
        again = f"Make the scene again (delete the folder {self.folder}, then run the command that made it), or copy it"
        remedy = "Copy the scene again" if is_url(self.folder) else again
        return DataError(f"{self.files.where(name)}: scene '{self.name}'{where}: {problem}. {remedy}")

    def unreadable(self, name: str, error: Exception) -> DataError:
        """Return the error for a file that the disk or the store cannot read."""
        says_where = isinstance(error, DataError)
        return DataError(str(error) if says_where else f"{self.files.where(name)}: cannot be read: {named(error)}")

    def __getstate__(self) -> dict[str, Any]:
        return {"folder": self.folder}

    def _column(self, member: str) -> int:
        if member not in self.index.members:
            raise self.damaged(INDEX, f"it has no member '{member}' (it has: {', '.join(self.index.members)})")
        return self.index.members.index(member)

    def checked(self, name: str, limit_bytes: int = LIMIT_BYTES) -> bytes:
        """Return the content of a file of the scene, not longer than the limit, compared with its checksum."""
        facts = self.meta["files"].get(name)
        content = self._content(name, limit_bytes)
        if facts is None or hashlib.sha256(content).hexdigest() != facts["sha256"]:
            raise self.damaged(name, "its checksum differs")
        return content

    def _content(self, name: str, limit_bytes: int = LIMIT_BYTES) -> bytes:
        try:
            return self.files.read(name, limit_bytes)
        except FileNotFoundError as error:
            raise self.damaged(name, "the file is missing") from error
        except Exception as error:  # each kind of store has errors of its own
            raise self.unreadable(name, error) from error

    def _json(self, name: str, content: bytes) -> dict[str, Any]:
        try:
            plain = parse_json(content)
        except ValueError as error:
            raise self.damaged(name, f"it is not valid JSON: {error}") from error
        if not isinstance(plain, dict):
            raise self.damaged(name, "it is not a JSON object")
        return plain
