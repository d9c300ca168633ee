"""Open bags that anybody may have made, before the package rosbags believes what is in them.

Rosbags makes Python code of the message definitions in a bag, runs the views of its database, waits for pipes, and
decompresses whatever comes. Here types are those of ROS alone, and files are looked at before they are opened.
"""

import bz2
import functools
import json
import sqlite3
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, closing, contextmanager, nullcontext
from pathlib import Path, PurePath
from tempfile import TemporaryDirectory
from typing import Any

from lz4.frame import LZ4FrameDecompressor
from rosbags.interfaces import Connection
from rosbags.rosbag1 import Reader as Reader1
from rosbags.rosbag1 import reader as rosbag1
from rosbags.rosbag2 import Reader as Reader2
from rosbags.rosbag2 import storage_mcap
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from omniocc.errors import DataError
from omniocc.io import check_regular, read_yaml

MOST_BYTES = 1 << 29
"""Most bytes of a message or chunk after decompression; the largest images have half of it."""
MOST_TIMES = 1000
"""A compressed file may become this many times as large, or `MOST_BYTES` if that is more; images reach a tenth."""
PART_BYTES = 1 << 20
SQLITE = b"SQLite format 3\0"
IN_URLS = "?#%"
"""Characters that sqlite takes for others: rosbags gives it paths as URLs."""
HEADER = "std_msgs/msg/Header"
TF_TYPES = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
zstd: Any = storage_mcap.zstd  # of Python 3.14, and a package of the same content before


def inflated(content: bytes, new: Callable[[], Any]) -> bytes:
    """Return the decompressed bytes of one or more frames; `new` returns a decompressor.

    Raises:
        ValueError: if they are more than `MOST_BYTES`, or the last frame is cut off.
    """
    parts, left = [], MOST_BYTES
    while content:
        one = new()
        parts.append(one.decompress(content, max_length=left + 1))
        left -= len(parts[-1])
        if left < 0:
            raise ValueError(f"a compressed part has more than {MOST_BYTES >> 20} MiB")
        if not one.eof:
            raise ValueError("a compressed part is cut off")
        content = one.unused_data
    return b"".join(parts)


_BY_NAME = {"bz2": bz2.BZ2Decompressor, "lz4": LZ4FrameDecompressor, "zstd": zstd.ZstdDecompressor}
rosbag1.decompressors.update({name: functools.partial(inflated, new=_BY_NAME[name]) for name in ("bz2", "lz4")})
storage_mcap.DECOMPRESSORS.update(
    {name: lambda content, size, new=_BY_NAME[name]: inflated(content, new) for name in ("lz4", "zstd")}
)


class BagReader:
    """An open bag of ROS 1 or 2; use it as a context manager. Its methods raise whatever rosbags and sqlite raise.

    Args:
        path: file of ROS 1 (`.bag`), or folder or file of ROS 2.
    """

    def __init__(self, path: Path):
        self.path, self.is_ros1 = path, path.suffix == ".bag"
        self.stack = ExitStack()

    def __enter__(self) -> "BagReader":
        with ExitStack() as stack:
            path = self.path
            if path.is_dir() and not self.is_ros1:
                path = stack.enter_context(_readable(path))
            else:
                _check_file(path)
            self.reader: Any = stack.enter_context(Reader1(path) if self.is_ros1 else Reader2(path))
            self.new = None
            if not self.is_ros1 and self.reader.compression_mode == "message":  # inflated here, within a limit
                self.reader.storage.metadata = self.reader.storage.metadata._replace(compression_mode=None)
                self.new = zstd.ZstdDecompressor
            self.extent = self.reader.message_count, self.reader.start_time, self.reader.end_time
            self.connections: list[Connection] = self.reader.connections
            for connection in self.connections:
                if not all(isinstance(text, str) for text in (connection.topic, connection.msgtype)):
                    raise DataError(f"{self.path}: {connection.topic!r:.80} is no name of a topic")
            if not all(isinstance(number, int) for number in self.extent):
                raise DataError(f"{self.path}: {self.extent!r:.80} are no count of messages, first and last time (ns)")
            self.stack = stack.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self.stack.close()

    def messages(
        self, connections: list[Connection], start_ns: int | None, stop_ns: int | None
    ) -> Iterator[tuple[int, Any]]:
        """Yield the time of receipt, ns, and the content of messages; raise TypeError if a type is none of ROS."""
        types = {connection.msgtype: _store_of(connection, self.is_ros1) for connection in connections}
        for connection, received_ns, content in self.reader.messages(connections, start_ns, stop_ns):
            if not isinstance(content, bytes) or not isinstance(received_ns, int):
                raise TypeError("a message has no bytes, or no time")
            store, whole = types[connection.msgtype], inflated(content, self.new) if self.new else content
            read = store.deserialize_ros1 if self.is_ros1 else store.deserialize_cdr
            yield received_ns, read(whole, connection.msgtype)


def _check_file(path: Path) -> None:
    """Raise DataError if a path is not of a regular file, or is of a database with views or computed columns."""
    check_regular(path)
    with path.open("rb") as file:
        if file.read(len(SQLITE)) != SQLITE:
            return
    if wrong := set(IN_URLS) & set(str(path)):
        raise DataError(f"{path}: databases with {wrong.pop()} in their path cannot be opened; rename it")
    query = (
        "SELECT l.name FROM pragma_table_list l, pragma_table_xinfo(l.name) x "
        "WHERE l.schema = 'main' AND (l.type <> 'table' OR x.hidden)"
    )
    with closing(sqlite3.connect(f"file:{path}?immutable=1", uri=True)) as database:
        if odd := database.execute(query).fetchone():
            raise DataError(f"{path}: {odd[0]!r:.80} is a view, or a table whose content is computed")


@contextmanager
def _readable(folder: Path) -> Iterator[Path]:
    """Give the folder of a bag of ROS 2 whose files may be opened: itself, or a temporary one if they are compressed.

    Raises:
        DataError: naming the file that must not be opened.
    """
    place = folder / "metadata.yaml"
    content = read_yaml(place) if place.exists() else None
    stated = content.get("rosbag2_bagfile_information") if isinstance(content, Mapping) else None
    stated = stated if isinstance(stated, Mapping) else {}
    listed = stated.get("relative_file_paths")
    names = [PurePath(name).name for name in listed if isinstance(name, str)] if isinstance(listed, list) else []
    files = [folder / name for name in names if (folder / name).exists()]
    packed = str(stated.get("compression_mode")).lower() == "file"
    with TemporaryDirectory() if packed else nullcontext(folder) as made:
        if packed:
            for file in files:
                check_regular(file)
                _unpack(file, Path(made) / file.stem)
            files = [Path(made) / file.stem for file in files]
            paths = [PurePath(name).stem for name in names]
            plain = {**stated, "relative_file_paths": paths, "compression_mode": "", "compression_format": ""}
            (Path(made) / place.name).write_text(json.dumps({"rosbag2_bagfile_information": plain}), "utf-8")
        for file in files:
            _check_file(file)
        yield Path(made)


def _unpack(source: Path, target: Path) -> None:
    """Decompress a file; raise DataError if it grows above both `MOST_BYTES` and `MOST_TIMES` its size."""
    most = max(MOST_BYTES, MOST_TIMES * source.stat().st_size)
    with zstd.open(source, "rb") as packed, target.open("xb") as file:
        while part := packed.read(PART_BYTES):
            file.write(part)
            if file.tell() > most:
                raise DataError(f"{source}: the file has more than {most:,} bytes when it is decompressed")


@functools.cache
def _stores(is_ros1: bool) -> tuple[Any, ...]:
    """Return the types of ROS; of ROS 2 those of its latest version, and those rosbags-convert copies from ROS 1."""
    first = get_typestore(Stores.ROS1_NOETIC)
    transforms = [get_types_from_msg("geometry_msgs/TransformStamped[] transforms\n", name) for name in TF_TYPES]
    first.register({name: fields for types in transforms for name, fields in types.items()})
    if is_ros1:
        return (first,)
    second, copied = get_typestore(Stores.LATEST), get_typestore(Stores.EMPTY)
    copied.register({**first.fielddefs, HEADER: second.fielddefs[HEADER]})
    return second, copied


def _store_of(connection: Connection, is_ros1: bool) -> Any:
    """Return the types by which the messages of a topic are read; raise TypeError if the bag's are others."""
    for store in _stores(is_ros1):
        if connection.msgtype not in store.fielddefs:
            continue
        known = store.generate_msgdef(connection.msgtype)[1] if is_ros1 else store.hash_rihs01(connection.msgtype)
        if connection.digest in ("", known):
            return store
    raise TypeError(f"its {connection.msgtype} ({connection.digest:.80}) is not that of ROS")
