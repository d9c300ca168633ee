"""Reading scene folders: any member of any frame by byte offset, every byte checked."""

import hashlib
import json
import zlib
from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float64, Int32, Int64, UInt32

from omniocc.data.store.files import Files, is_url, read_members
from omniocc.data.store.shard import INDEX, META, SCHEMA, digest, shard_name
from omniocc.errors import DataError, UserError
from omniocc.io import checked_name


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
    """Return the index that `index.json` holds; raise KeyError, TypeError or ValueError if something is missing."""
    frames, members = plain["frames"], tuple(plain["members"])
    entries = [frame["entry"] for frame in frames if frame["entry"]]
    offset, size, crc32 = (
        np.array([frame[key] for frame in frames], dtype).reshape(len(frames), len(members))
        for key, dtype in (("offset", np.int64), ("size", np.int32), ("crc32", np.uint32))
    )
    return Index(
        members, np.array([frame["shard"] for frame in frames], np.int32), offset, size, crc32,
        np.array([entry["time_s"] for entry in entries], np.float64),
        np.array([entry["world_from_ego"] for entry in entries] or np.empty((0, 4, 4)), np.float64),
    )  # fmt: skip


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
        if meta["schema"] != SCHEMA:
            raise self.damaged(META, f"schema {meta['schema']}, this version reads {SCHEMA}")
        for name in meta["files"]:
            try:
                checked_name("the name of a file", name)
            except UserError as error:
                raise self.damaged(META, str(error)) from error
        return meta

    @cached_property
    def index(self) -> Index:
        """Return where every member of every frame lies."""
        plain = self._json(INDEX, self.checked(INDEX))
        try:
            return read_index(plain)
        except (KeyError, TypeError, ValueError) as error:
            raise self.damaged(INDEX, f"it is no index ({error!r})") from error

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
        return DataError(f"{self.files.where(name)}: cannot be read: {type(error).__name__}: {error}")

    def __getstate__(self) -> dict[str, Any]:
        return {"folder": self.folder}

    def _column(self, member: str) -> int:
        if member not in self.index.members:
            raise self.damaged(INDEX, f"it has no member '{member}' (it has: {', '.join(self.index.members)})")
        return self.index.members.index(member)

    def checked(self, name: str) -> bytes:
        """Return the content of a file of the scene, compared with its checksum."""
        facts = self.meta["files"].get(name)
        content = self._content(name)
        if facts is None or hashlib.sha256(content).hexdigest() != facts["sha256"]:
            raise self.damaged(name, "its checksum differs")
        return content

    def _content(self, name: str) -> bytes:
        try:
            return self.files.read(name)
        except FileNotFoundError as error:
            raise self.damaged(name, "the file is missing") from error
        except Exception as error:  # each kind of store has errors of its own
            raise self.unreadable(name, error) from error

    def _json(self, name: str, content: bytes) -> dict[str, Any]:
        try:
            plain = json.loads(content)
        except ValueError as error:
            raise self.damaged(name, "it is not valid JSON") from error
        if not isinstance(plain, dict):
            raise self.damaged(name, "it is not a JSON object")
        return plain
