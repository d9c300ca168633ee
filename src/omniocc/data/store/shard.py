"""Scene folders: `meta.json`, `index.json` and uncompressed tar shards of one blob per member.

    <scene>/meta.json         schema, facts of the scene, size and sha256 of every other file; its own digest
            index.json        per frame: shard, time, pose; per member: byte offset, size and crc32
            frames-000.tar    members `000012.rgb0.jpg`; a new shard begins when the next frame would pass the limit

The folder gets its name by one rename when it is complete. Until then it is called `<scene>.partial`, and
`journal.jsonl` lists the complete frames: after a kill `SceneWriter` cuts off everything after the last of them and
continues. Nothing in a folder depends on when, where or in how many pieces it was made: equal frames give equal bytes.
"""

import hashlib
import json
import tarfile
import zlib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, BinaryIO

from omniocc.errors import DataError
from omniocc.io import atomic_write, cannot_write

SCHEMA = 3
SHARD_LIMIT_BYTES = 256 * 2**20
META, INDEX, JOURNAL = "meta.json", "index.json", "journal.jsonl"
_BLOCK = tarfile.BLOCKSIZE
_END = bytes(2 * _BLOCK)


class SceneWriter:
    """The writer of a scene's frames; continues after the last whole frame of an interrupted run.

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
        if not self.finished:
            self._guard(self._recover)

    @property
    def finished(self) -> bool:
        """Return whether the scene is complete; does the last rename if the writer was killed just before it."""
        if not self.folder.exists() and (self.work / META).exists():
            self._guard(self._publish)
        return self.folder.exists()

    @property
    def num_frames(self) -> int:
        """Return the number of complete frames."""
        return len(self._records)

    def append(self, blobs: Mapping[str, bytes], entry: Mapping[str, Any]) -> None:
        """Write the blobs of one frame, by member name, and its entry of the index (plain values).

        All frames of a scene have members of the same names.
        """
        frame = self.num_frames
        assert not self._records or list(blobs) == self._records[0]["members"]
        shard, begin = self._position()
        chunk, offsets = _tar_members(frame, blobs)
        if begin and begin + len(chunk) + len(_END) > self._limit:
            self._guard(self._close_shard)
            shard, begin = shard + 1, 0
        record = {
            "shard": shard,
            "end": begin + len(chunk),
            "members": list(blobs),
            "offset": [begin + offset for offset in offsets],
            "size": [len(blob) for blob in blobs.values()],
            "crc32": [zlib.crc32(blob) for blob in blobs.values()],
            "entry": dict(entry),
        }
        self._guard(lambda: self._write(shard, chunk, record))
        self._records.append(record)

    def attach(self, name: str, save: Callable[[Path], None]) -> None:
        """Let `save(path)` write a further file (and files beside it) into the scene; call it just before `finish`."""
        self._guard(lambda: save(self.work / name))

    def finish(self, facts: Mapping[str, Any]) -> None:
        """Write the index, the checksums and `facts` (plain values about the making), then give the final name."""
        assert self._records
        self._guard(self._close_shard)
        frames = [{k: v for k, v in record.items() if k not in ("end", "members")} for record in self._records]
        atomic_write(self.work / INDEX, _dump({"members": self._records[0]["members"], "frames": frames}))
        paths = sorted(
            path for path in self.work.iterdir() if path.name not in (META, JOURNAL) and path.suffix != ".tmp"
        )
        files = {path.name: {"size": path.stat().st_size, "sha256": sha256(path)} for path in paths}
        meta = {"schema": SCHEMA, "scene": self.folder.name, "frames": self.num_frames}
        meta |= {"facts": dict(facts), "files": files}
        atomic_write(self.work / META, _dump(meta | {"digest": digest(meta)}))
        self._guard(self._publish)

    def close(self) -> None:
        """Close the open shard; complete frames remain."""
        if self._shard is not None:
            self._shard.close()
            self._shard = None

    def _guard(self, action: Callable[[], None]) -> None:
        try:
            action()
        except DataError:
            raise
        except OSError as error:
            self.close()
            raise cannot_write(self.folder, error) from error

    def _position(self) -> tuple[int, int]:
        return (self._records[-1]["shard"], self._records[-1]["end"]) if self._records else (0, 0)

    def _write(self, shard: int, chunk: bytes, record: dict[str, Any]) -> None:
        if self._shard is None:
            self._shard = (self.work / shard_name(shard)).open("ab", buffering=0)
        _write_all(self._shard, chunk)
        line = json.dumps(record, default=float).encode()
        with (self.work / JOURNAL).open("ab", buffering=0) as journal:
            _write_all(journal, b"%08x %s\n" % (zlib.crc32(line), line))

    def _close_shard(self) -> None:
        shard, end = self._position()
        self.close()
        with (self.work / shard_name(shard)).open("r+b") as file:
            file.truncate(end)
            file.seek(end)
            file.write(_END)

    def _recover(self) -> None:
        self.work.mkdir(parents=True, exist_ok=True)
        journal = self.work / JOURNAL
        kept = 0
        for line in journal.read_bytes().splitlines(keepends=True) if journal.exists() else []:
            record = _parse(line)
            if record is None or not _is_whole(self.work / shard_name(record["shard"]), record):
                break
            self._records.append(record)
            kept += len(line)
        if journal.exists():
            with journal.open("r+b") as file:
                file.truncate(kept)
        shard, end = self._position()
        for path in self.work.iterdir():
            if path.name == shard_name(shard) and self._records:
                with path.open("r+b") as file:
                    file.truncate(end)
            elif path.name != JOURNAL and not (path.suffix == ".tar" and path.name < shard_name(shard)):
                path.unlink()

    def _publish(self) -> None:
        (self.work / JOURNAL).unlink(missing_ok=True)
        self.work.rename(self.folder)


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


def _parse(line: bytes) -> dict[str, Any] | None:
    checksum, _, content = line.rstrip(b"\n").partition(b" ")
    if not line.endswith(b"\n") or checksum != b"%08x" % zlib.crc32(content):
        return None
    return json.loads(content)


def _is_whole(shard: Path, record: Mapping[str, Any]) -> bool:
    if not shard.exists() or shard.stat().st_size < record["end"]:
        return False
    with shard.open("rb") as file:
        for offset, size, crc32 in zip(record["offset"], record["size"], record["crc32"], strict=True):
            file.seek(offset)
            if zlib.crc32(file.read(size)) != crc32:
                return False
    return True
