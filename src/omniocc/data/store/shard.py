"""Scene folders: `meta.json`, `index.json` and uncompressed tar shards of one blob per member.

    <scene>/meta.json         schema, facts of the scene, size and sha256 of every other file; its own digest
            index.json        per frame: shard, time, pose; per member: byte offset, size and crc32
            frames-000.tar    members `000012.rgb0.jpg`; a new shard begins when the next frame would pass the limit

The folder gets its name by one rename when it is complete. Until then it is called `<scene>.partial`; what a killed
process left there is thrown away, and the scene is made again. Nothing in a folder depends on when or where it was
made: equal frames give equal bytes.
"""

import hashlib
import json
import shutil
import tarfile
import zlib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, BinaryIO

from omniocc.errors import DataError
from omniocc.io import atomic_write, cannot_write

SCHEMA = 3
SHARD_LIMIT_BYTES = 256 * 2**20
META, INDEX = "meta.json", "index.json"
_BLOCK = tarfile.BLOCKSIZE
_END = bytes(2 * _BLOCK)


class SceneWriter:
    """The writer of a scene's frames, from the first one on; it removes what an interrupted run has left of them.

    One process at a time may write a scene: callers hold a lock.

    Args:
        folder: final name of the scene.
        shard_limit_bytes: largest size of a shard of more than one frame.

    Raises:
        DataError: when the disk refuses (full, read-only), here and in every method.
    """

    def __init__(self, folder: Path, shard_limit_bytes: int = SHARD_LIMIT_BYTES):
        self.folder = folder
        self.work = folder.with_name(folder.name + ".partial")
        self._limit = shard_limit_bytes
        self._shard: BinaryIO | None = None
        self._records: list[dict[str, Any]] = []
        self._members: list[str] = []
        self._end = 0, 0  # shard and offset at which the next frame begins
        if not self.finished:
            self._guard(self._begin)

    @property
    def finished(self) -> bool:
        """Return whether the scene is complete."""
        return self.folder.exists()

    @property
    def num_frames(self) -> int:
        """Return the number of frames that were written."""
        return len(self._records)

    def append(self, blobs: Mapping[str, bytes], entry: Mapping[str, Any]) -> None:
        """Write the blobs of one frame, by member name, and its entry of the index (plain values).

        All frames of a scene have members of the same names.
        """
        frame = self.num_frames
        assert not self._records or list(blobs) == self._members
        shard, begin = self._end
        chunk, offsets = _tar_members(frame, blobs)
        if begin and begin + len(chunk) + len(_END) > self._limit:
            self._guard(self._close_shard)
            shard, begin = shard + 1, 0
        self._guard(lambda: self._write(shard, chunk))
        self._members, self._end = list(blobs), (shard, begin + len(chunk))
        record = {
            "shard": shard,
            "offset": [begin + offset for offset in offsets],
            "size": [len(blob) for blob in blobs.values()],
            "crc32": [zlib.crc32(blob) for blob in blobs.values()],
            "entry": dict(entry),
        }
        self._records.append(record)

    def attach(self, name: str, save: Callable[[Path], None]) -> None:
        """Let `save(path)` write a further file (and files beside it) into the scene; call it just before `finish`."""
        self._guard(lambda: save(self.work / name))

    def finish(self, facts: Mapping[str, Any]) -> None:
        """Write the index, the checksums and `facts` (plain values about the making), then give the final name."""
        assert self._records
        self._guard(self._close_shard)
        atomic_write(self.work / INDEX, _dump({"members": self._members, "frames": self._records}))
        paths = sorted(self.work.iterdir())
        files = {path.name: {"size": path.stat().st_size, "sha256": sha256(path)} for path in paths}
        meta = {"schema": SCHEMA, "scene": self.folder.name, "frames": self.num_frames}
        meta |= {"facts": dict(facts), "files": files}
        atomic_write(self.work / META, _dump(meta | {"digest": digest(meta)}))
        self._guard(lambda: self.work.rename(self.folder))

    def close(self) -> None:
        """Close the open shard."""
        if self._shard is not None:
            self._shard.close()
            self._shard = None

    def _guard(self, action: Callable[[], Any]) -> None:
        try:
            action()
        except DataError:
            raise
        except OSError as error:
            self.close()
            raise cannot_write(self.folder, error) from error

    def _begin(self) -> None:
        if self.work.exists():
            shutil.rmtree(self.work)
        self.work.mkdir(parents=True)

    def _write(self, shard: int, chunk: bytes) -> None:
        if self._shard is None:
            self._shard = (self.work / shard_name(shard)).open("wb", buffering=0)
        _write_all(self._shard, chunk)

    def _close_shard(self) -> None:
        assert self._shard is not None
        _write_all(self._shard, _END)
        self.close()


def shard_name(shard: int) -> str:
    """Return the file name of a shard."""
    return f"frames-{shard:03d}.tar"


def member_name(frame: int, member: str) -> str:
    """Return the name of a member within its tar file."""
    return f"{frame:06d}.{member}"


def sha256(path: Path) -> str:
    """Return the hex digest (SHA-256) of a file."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def digest(plain: Any) -> str:
    """Return the hex digest of plain data, independent of the order of keys."""
    return hashlib.sha256(json.dumps(plain, sort_keys=True).encode()).hexdigest()


def _tar_members(frame: int, blobs: Mapping[str, bytes]) -> tuple[bytes, list[int]]:
    chunk, offsets = bytearray(), []
    for name, blob in blobs.items():
        info = tarfile.TarInfo(member_name(frame, name))  # mtime, uid and gid are 0 unless set
        info.size = len(blob)
        chunk += info.tobuf(tarfile.USTAR_FORMAT)
        offsets.append(len(chunk))
        chunk += blob + bytes(-len(blob) % _BLOCK)
    return bytes(chunk), offsets


def _write_all(file: BinaryIO, content: bytes) -> None:
    view = memoryview(content)
    while view:
        view = view[file.write(view) :]


def _dump(plain: Any) -> bytes:
    return (json.dumps(plain, indent=None, separators=(",", ":")) + "\n").encode()
