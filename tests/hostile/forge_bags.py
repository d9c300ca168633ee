"""Forge ROS bags of both versions: their containers, their metadata, and the messages in them."""

import bz2
import functools
import itertools
import random
import sqlite3
import struct
import zlib
from collections.abc import Callable, Iterable
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from bag_files import BASE_OPTION, BagWriter, write_bag
from lz4.frame import LZ4FrameCompressor
from mutate import BROKEN, DAMAGED
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.rosbag2.reader import zstd
from sandbox import Box, Case, Opening

from omniocc.data.store.reader import SceneReader

KIND = "bags"
SCENE = "test-000-here"
KINDS = {"ros1": "log.bag", "db3": "log/log.db3", "mcap": "log/log.mcap", "metadata": "log/metadata.yaml"}
"""The file of each kind that is damaged."""
IMAGE, CLOUD = "sensor_msgs/msg/Image", "sensor_msgs/msg/PointCloud2"
BOMB_PARTS, BOMB_PART = 128, bytes(1 << 26)
SCRIPT = "<script>alert(1)</script>\n\x1b[31m../../neighbour"
Change = Callable[[BagWriter, dict[str, Any]], Any]


class Forged(BagWriter):
    """A bag whose messages of one type, or whose bytes of them, are changed.

    Attributes:
        storage: `mcap` or `db3` in ROS 2.
        kind: end of the type of messages.
        change: is given the fields of a message before it is written.
        packed: is given the bytes of a message and returns others.
        definition: text that stands for the definition of every message.
        digest: of the definitions; None: the right one.
    """

    def __init__(
        self,
        path: Path,
        ros: int,
        storage: str = "db3",
        kind: str = "",
        change: Change = lambda bag, fields: None,
        packed: Callable[[bytes], bytes] = bytes,
        definition: str | None = None,
        digest: str | None = None,
        compression: str = "",
    ):
        super().__init__(path, ros)
        self.kind, self.change, self.packed, self.definition, self.digest = kind, change, packed, definition, digest
        if ros == 2 and storage == "mcap":
            self.bag = Writer2(path, version=8, storage_plugin=StoragePlugin.MCAP)
        if compression and ros == 1:
            self.bag.set_compression(Writer1.CompressionFormat[compression.upper()])
        elif compression:
            self.bag.set_compression(CompressionMode[compression.upper()], CompressionFormat.ZSTD)

    def connect(self, topic: str, kind: str) -> Any:
        if self.definition is None and self.digest is None:
            return super().connect(topic, kind)
        text, md5sum = self.store.generate_msgdef(kind, ros_version=self.ros)
        own = {"md5sum": md5sum} if self.ros == 1 else {"rihs01": self.store.hash_rihs01(kind)}
        own = own if self.digest is None else dict.fromkeys(own, self.digest)
        return self.bag.add_connection(topic, kind, msgdef=self.definition or text, **own)

    def content(self, kind: str, fields: dict[str, Any]) -> bytes:
        if not self.kind or not kind.endswith(self.kind):
            return super().content(kind, fields)
        self.change(self, fields)
        return self.packed(super().content(kind, fields))


def same_scene(base: Path) -> Callable[[Path, str], str | None]:
    """Return a check that the scene is that of the sound bag: poses, images and points."""

    def check(out: Path, text: str) -> str | None:
        ours, right = (SceneReader(place / "test-000-log") for place in (out / "result", base / "recorded-bag"))
        if ours.world_from_ego.shape != right.world_from_ego.shape:
            return f"{len(ours)} of {len(right)} frames"
        if not np.allclose(ours.world_from_ego, right.world_from_ego, atol=1e-9):
            return "its poses are others"
        for frame in range(len(right)):
            if not all(map(np.array_equal, ours.images(frame), right.images(frame))):
                return f"the images of frame {frame} are others"
            if not np.array_equal(ours.points(frame).points_m, right.points(frame).points_m):
                return f"the points of frame {frame} are others"
        return None

    return check


def record_bag(base: Path, bag: Path, out: Path, *more: str) -> tuple[str, ...]:
    """Return the command that makes a scene of a bag."""
    names = SceneReader(base / "scenes" / SCENE).rig.names
    cameras = ",".join(f"{name}:/{name}/image" for name in names)
    return (
        "record.py",
        "recorder=bag",
        "recorder.name=test-000-log",
        f"recorder.bag={bag}",
        "recorder.world_frame=map",
        f"recorder.rig={base / 'log' / 'rig.yaml'}",
        f"recorder.cameras={{{cameras}}}",
        f"recorder.{BASE_OPTION}",
        f"recorder.lidar={{topic: /points, classes: {base / 'log' / 'classes.yaml'}}}",
        "recorder.road_z_m=-2.0",
        "recorder.panorama=[48,12,45.0,-45.0]",
        f"output={out}",
        *more,
    )


def written(box: Box, ros: int, **forged: Any) -> Path:
    """Write a bag of a scene with some change."""
    path = box.given / ("log.bag" if ros == 1 else "log")
    return write_bag(SceneReader(box.base / "scenes" / SCENE), path, ros, functools.partial(Forged, **forged))


def opened(box: Box, bag: Path, expect: str, *more: str, names: tuple[str, ...] = ()) -> list[Opening]:
    check = same_scene(box.base) if expect == "right" else None
    return [Opening(record_bag(box.base, bag, box.out / "result", *more), expect, names or (bag.name,), check)]


def predict_bag(base: Path, bag: Path, out: Path) -> tuple[str, ...]:
    """Return the command that predicts ranges of the images of a bag."""
    rig = f"rig={base / 'log' / 'rig.yaml'}"
    return ("predict.py", "depth", f"images={bag}", rig, f"output={out}", "checkpoint=sweep", "preset=smoke")


def _set(**new: Any) -> Change:
    """Return a change of fields; a function is given the old value."""

    def change(bag: BagWriter, fields: dict[str, Any]) -> None:
        for name, value in new.items():
            fields[name] = value(fields[name]) if callable(value) else value

    return change


def _stamp(sec: int, nanosec: int = 0) -> Change:
    def change(bag: BagWriter, fields: dict[str, Any]) -> None:
        fields["header"].stamp.sec, fields["header"].stamp.nanosec = sec, nanosec

    return change


def _field(place: int, **new: Any) -> Change:
    """Return a change of a field of points."""

    def change(bag: BagWriter, fields: dict[str, Any]) -> None:
        for name, value in new.items():
            setattr(fields["fields"][place], name, value)

    return change


def _many_fields(bag: BagWriter, fields: dict[str, Any]) -> None:
    more = [bag.make("sensor_msgs/msg/PointField", name=f"f{n}", offset=0, datatype=2, count=1) for n in range(60_000)]
    fields["fields"] = [*fields["fields"], *more]


def _rotation(**new: float) -> Change:
    """Return a change of the quaternions of tf or odometry."""

    def change(bag: BagWriter, fields: dict[str, Any]) -> None:
        ones = [one.transform.rotation for one in fields.get("transforms", ())]
        for rotation in ones or [fields["pose"].pose.orientation]:
            for name, value in new.items():
                setattr(rotation, name, value)

    return change


def _shift(x: float) -> Change:
    def change(bag: BagWriter, fields: dict[str, Any]) -> None:
        for one in fields["transforms"]:
            one.transform.translation.x = x

    return change


def _chain(bag: BagWriter, fields: dict[str, Any]) -> None:
    """Add a long chain of frames that hangs on the car, and a frame in itself."""
    one = fields["transforms"][0]
    names = ["base_link", "base_link", *(f"link{number}" for number in range(20_000))]
    make = functools.partial(bag.make, "geometry_msgs/msg/TransformStamped", transform=one.transform)
    fields["transforms"] = [
        *fields["transforms"],
        *(make(header=bag.header(1, up), child_frame_id=down) for up, down in itertools.pairwise(names)),
    ]


def _png(side: int) -> np.ndarray:
    """Return a PNG that claims a width and height."""
    head = b"IHDR" + struct.pack(">IIBBBBB", side, side, 8, 2, 0, 0, 0)
    body = b"IDAT" + zlib.compress(bytes(1000))
    chunks = [struct.pack(">I", len(part) - 4) + part + struct.pack(">I", zlib.crc32(part)) for part in (head, body)]
    return np.frombuffer(b"\x89PNG\r\n\x1a\n" + b"".join(chunks), np.uint8)


def _length(old: int) -> Callable[[bytes], bytes]:
    """Return a change of the last length in a message that is `old`: it claims gigabytes."""
    return lambda content: b"\xf0\xff\xff\xff".join(content.rsplit(struct.pack("<I", old), 1))


ROW, HEIGHT, POINTS = 64 * 3 + 4, 36, 6000 * 18
COMPRESSED, ODOMETRY, TRANSFORMS = "CompressedImage", "Odometry", "TFMessage"
MESSAGES: dict[str, tuple[str, str, Change]] = {
    # name: what has to come of it, the type of message, the change
    "image-gigapixels": ("refused", "/Image", _set(width=49152, height=49152)),
    "image-gigapixels-in-step": ("refused", "/Image", _set(width=49152, height=49152, step=49152 * 3)),
    "image-of-nothing": ("refused", "/Image", _set(width=0, height=0, step=0)),
    "image-step-small": ("refused", "/Image", _set(step=64 * 3 - 1)),
    "image-step-zero": ("refused", "/Image", _set(step=0)),
    "image-step-huge": ("refused", "/Image", _set(step=2**32 - 1)),
    "image-data-short": ("refused", "/Image", _set(data=lambda data: data[:-1])),
    "image-encoding-script": ("refused", "/Image", _set(encoding=SCRIPT)),
    "image-encoding-long": ("refused", "/Image", _set(encoding="rgb8" * 2**18)),
    "image-encoding-words": ("refused", "/Image", _set(encoding="mono99")),
    "image-yuv-of-odd-width": ("refused", "/Image", _set(encoding="yuv422", width=63)),
    "image-bayer-of-a-pixel": ("refused", "/Image", _set(encoding="bayer_rggb8", width=1, height=1)),
    "compressed-gigapixels": ("refused", COMPRESSED, _set(data=_png(49152))),
    "compressed-format-long": ("refused", COMPRESSED, _set(format="x\n" * 2**19, data=lambda data: data[:9])),
    "compressed-format-script": ("right", COMPRESSED, _set(format=SCRIPT)),
    "compressed-nothing": ("refused", COMPRESSED, _set(data=lambda data: data[:0])),
    "points-field-twice": ("refused", CLOUD, _field(3, name="x")),
    "points-field-beyond": ("refused", CLOUD, _field(2, offset=18)),
    "points-field-far-beyond": ("refused", CLOUD, _field(2, offset=2**32 - 1)),
    "points-field-type-unknown": ("refused", CLOUD, _field(0, datatype=99)),
    "points-field-script": ("refused", CLOUD, _field(0, name=SCRIPT * 1000)),
    "points-fields-many": ("right", CLOUD, _many_fields),
    "points-step-zero": ("refused", CLOUD, _set(point_step=0)),
    "points-step-huge": ("refused", CLOUD, _set(point_step=2**32 - 1)),
    "points-row-zero": ("refused", CLOUD, _set(row_step=0)),
    "points-short": ("refused", CLOUD, _set(data=lambda data: data[:-1])),
    "points-billions": ("refused", CLOUD, _set(width=2**32 - 1, height=2**32 - 1)),
    "points-none-in-billions-of-rows": ("refused", CLOUD, _set(width=0, row_step=0, height=2**32 - 1)),
    "points-nan": ("refused", CLOUD, _set(data=lambda data: np.full_like(data, 255))),
    "tf-nan": ("refused", TRANSFORMS, _rotation(x=float("nan"))),
    "tf-zero": ("refused", TRANSFORMS, _rotation(x=0.0, y=0.0, z=0.0, w=0.0)),
    "tf-long": ("refused", TRANSFORMS, _rotation(w=1e300)),
    "tf-far": ("refused", TRANSFORMS, _shift(1e300)),
    "tf-chain": ("right", TRANSFORMS, _chain),
    "odometry-nan": ("refused", ODOMETRY, _rotation(w=float("nan"))),
    "odometry-zero": ("refused", ODOMETRY, _rotation(x=0.0, y=0.0, z=0.0, w=0.0)),
    "odometry-at-one-time": ("refused", ODOMETRY, _stamp(5)),
    "images-at-one-time": ("refused", "/Image", _stamp(2**31 - 1, 2**32 - 1)),
    "images-without-time": ("either", "/Image", _stamp(0)),
}
PACKED: dict[str, tuple[str, Callable[[bytes], bytes]]] = {
    "image-length-gigabytes": ("/Image", _length(ROW * HEIGHT)),
    "points-length-gigabytes": (CLOUD, _length(POINTS)),
    "image-message-empty": ("/Image", lambda content: b""),
    "tf-message-cut": (TRANSFORMS, lambda content: content[:9]),
    "tf-of-billions": (TRANSFORMS, lambda content: content[:4] + b"\xff" * 4 + content[8:]),
}
"""Changes of the bytes of messages, which are refused."""
PREDICTED = ("image", "compressed", "tf")
"""Names begin so where `predict.py` reads what was changed."""
DEFINITIONS = {
    "recursive": "geometry_msgs/TransformStamped transform\nsensor_msgs/Image again\n",
    "malformed": "float64[ x y = =\n",
    "of-billions": "geometry_msgs/Point[999999999] points\nstring[999999999] texts\n",
    "empty": "\n",
    "of-code": "int32 A=__import__('os').system('touch x')\nstring B=\"\"\"\\\n\nimport os\n",
    "swapped": "byte[] data\n",
}
"""Definitions that no reader of ROS needs, since it knows its types."""


def _backwards(box: Box, ros: int) -> Path:
    """Write a bag whose messages are received in the opposite order."""

    class Backwards(Forged):
        def write(self, topic: str, kind: str, received_ns: int, **fields: Any) -> None:
            super().write(topic, kind, 3_400_000_000_000_000_000 - received_ns, **fields)

    return write_bag(SceneReader(box.base / "scenes" / SCENE), _place(box, ros), ros, Backwards)


def _place(box: Box, ros: int) -> Path:
    return box.given / ("log.bag" if ros == 1 else "log")


def _beside(box: Box, ros: int, topic: str) -> Path:
    """Write a bag with one more topic."""

    class More(Forged):
        def __exit__(self, *_: object) -> None:
            self.write(topic, "std_msgs/msg/String", 1_700_000_000_000_000_000, data="x")
            super().__exit__()

    return write_bag(SceneReader(box.base / "scenes" / SCENE), _place(box, ros), ros, More)


ZSTD = {"compression_format": "zstd"}
STATED: dict[str, tuple[str, Callable[[dict[str, Any]], Any]]] = {
    "count-text": ("refused", lambda stated: stated.update(message_count="many")),
    "count-list": ("refused", lambda stated: stated.update(message_count=[1])),
    "count-huge": ("right", lambda stated: stated.update(message_count=10**4000)),
    "version-text": ("refused", lambda stated: stated.update(version="nine")),
    "version-next": ("refused", lambda stated: stated.update(version=10)),
    "start-nan": ("refused", lambda stated: stated.update(starting_time={"nanoseconds_since_epoch": float("nan")})),
    "start-negative": ("right", lambda stated: stated.update(starting_time={"nanoseconds_since_epoch": -(10**30)})),
    "paths-a-number": ("refused", lambda stated: stated.update(relative_file_paths=7)),
    "paths-numbers": ("refused", lambda stated: stated.update(relative_file_paths=[7])),
    "paths-none": ("refused", lambda stated: stated.update(relative_file_paths=[])),
    "paths-outward": ("right", lambda stated: stated.update(relative_file_paths=["../../neighbour/log.db3"])),
    "paths-absolute": ("refused", lambda stated: stated.update(relative_file_paths=["/etc/passwd"])),
    "paths-upwards": ("refused", lambda stated: stated.update(relative_file_paths=[".."])),
    "paths-twice": ("right", lambda stated: stated["relative_file_paths"].append("log.db3")),
    "storage-unknown": ("refused", lambda stated: stated.update(storage_identifier=SCRIPT * 1000)),
    "storage-other": ("refused", lambda stated: stated.update(storage_identifier="mcap")),
    "topic-a-number": ("refused", lambda stated: _topic(stated).update(name=5)),
    "topic-type-a-list": ("refused", lambda stated: _topic(stated).update(type=["a"])),
    "topics-a-text": ("refused", lambda stated: stated.update(topics_with_message_count="all")),
    "compression-unknown": ("refused", lambda stated: stated.update(compression_mode="file", compression_format="x")),
    "compression-of-none": ("refused", lambda stated: stated.update(ZSTD, compression_mode="FILE")),
    "messages-of-none": ("refused", lambda stated: stated.update(ZSTD, compression_mode="message")),
}
"""Changes of `metadata.yaml`."""
TEXTS: dict[str, Callable[[str], str]] = {
    "tag-of-code": lambda text: text.replace("version: 8", "version: !!python/object/apply:os.system ['touch x']"),
    "key-twice": lambda text: text.replace("  version: 8", "  version: 8\n  version: 3"),
    "aliases": lambda text: text.replace("storage_identifier: sqlite3", f"storage_identifier: {_aliases()}"),
    "nested": lambda text: text.replace("storage_identifier: sqlite3", "storage_identifier: " + "[" * 10**5),
    "list": lambda text: "- 1\n",
    "number": lambda text: "7",
    "no-text": lambda text: text + "\0",
}
"""Changes of its text, which are refused."""


def _topic(stated: dict[str, Any]) -> dict[str, Any]:
    return stated["topics_with_message_count"][0]["topic_metadata"]


def _aliases() -> str:
    levels = [f"&a{n} [{', '.join([f'*a{n - 1}'] * 9) if n else 'lol'}]" for n in range(30)]
    return f"[{', '.join(levels)}]"


ENDLESS = "WITH RECURSIVE n(x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM n) SELECT"
TABLES: dict[str, tuple[str, str]] = {
    # name: what has to come of it, what is done to the database
    "view-of-definitions": (
        "refused",
        "DROP TABLE message_definitions; CREATE VIEW message_definitions AS "
        f"{ENDLESS} x AS id, 'a' AS topic_type, '' AS encoding, '' AS encoded_message_definition, '' AS "
        "type_description_hash FROM n",
    ),
    "view-of-versions": (
        "refused",
        f"DROP TABLE schema; CREATE VIEW schema AS {ENDLESS} x AS schema_version FROM n WHERE x < 0",
    ),
    "computed-column": ("refused", "ALTER TABLE messages ADD COLUMN more AS (zeroblob(1000000000))"),
    "virtual-table": ("refused", "DROP TABLE schema; CREATE VIRTUAL TABLE schema USING fts5(schema_version)"),
    "trigger": ("right", "CREATE TRIGGER t AFTER INSERT ON messages BEGIN DELETE FROM messages; END"),
    "times-of-text": ("refused", "UPDATE messages SET timestamp = 'soon' WHERE id > 3"),
    "times-negative": ("right", "UPDATE messages SET timestamp = -timestamp"),
    "messages-of-text": ("refused", "UPDATE messages SET data = 'text' WHERE id > 3"),
    "messages-of-numbers": ("refused", "UPDATE messages SET data = 5 WHERE id > 3"),
    "messages-of-zeros": ("refused", "UPDATE messages SET data = zeroblob(1000000) WHERE id > 3"),
    "no-messages": ("refused", "DELETE FROM messages"),
    "no-table": ("refused", "DROP TABLE messages"),
    "topics-renamed": ("refused", "UPDATE topics SET name = 5"),
    "version-of-text": (
        "refused",
        "DROP TABLE schema; CREATE TABLE schema(schema_version); INSERT INTO schema VALUES ('new')",
    ),
    "definition-in-brackets": (
        "right",
        "UPDATE message_definitions SET encoding = 'ros2idl', encoded_message_definition = "
        "'module a { const long X = " + "(" * 20 + "1" + ")" * 20 + "; };'",
    ),
}


def _stated(box: Box, change: Callable[[dict[str, Any]], Any]) -> Path:
    path = written(box, 2)
    content = yaml.safe_load((path / "metadata.yaml").read_text())
    change(content["rosbag2_bagfile_information"])
    (path / "metadata.yaml").write_text(yaml.safe_dump(content))
    return path


def _text(box: Box, change: Callable[[str], str]) -> Path:
    path = written(box, 2)
    place = path / "metadata.yaml"
    place.write_text(change(place.read_text()))
    return path


def _database(box: Box, commands: str) -> Path:
    path = written(box, 2)
    with closing(sqlite3.connect(path / "log.db3", isolation_level=None)) as database:
        database.executescript(commands)
    return path


def _name_of_url(box: Box) -> Path:
    """Write a bag whose database has a name that is the URL of a neighbour's."""
    path = _stated(box, lambda stated: stated.update(relative_file_paths=["%2e%2e%2f%2e%2e%2fneighbour%2fa.db3"]))
    (box.neighbour / "a.db3").write_bytes((path / "log.db3").read_bytes())
    (path / "log.db3").rename(path / "%2e%2e%2f%2e%2e%2fneighbour%2fa.db3")
    return path


@functools.cache
def _bomb(kind: str) -> bytes:
    """Return eight gigabytes of zeros."""
    if kind == "lz4":
        lz4 = LZ4FrameCompressor()
        return lz4.begin() + b"".join(lz4.compress(BOMB_PART) for _ in range(BOMB_PARTS)) + lz4.flush()
    return {"bz2": bz2.compress, "zstd": zstd.compress}[kind](BOMB_PART) * BOMB_PARTS


def _bomb_of_ros1(box: Box, kind: str) -> Path:
    class Bomb(Forged):
        def __init__(self, path: Path, ros: int):
            super().__init__(path, ros, compression=kind)
            self.bag.compressor = lambda content: _bomb(kind)

    return write_bag(SceneReader(box.base / "scenes" / SCENE), _place(box, 1), 1, Bomb)


def _bomb_of_mcap(box: Box) -> Path:
    class Bomb(Forged):
        def __enter__(self) -> "Bomb":
            super().__enter__()
            self.bag.storage.compression, self.bag.storage.compressor = "zstd", lambda content: _bomb("zstd")
            return self

    return write_bag(
        SceneReader(box.base / "scenes" / SCENE), _place(box, 2), 2, functools.partial(Bomb, storage="mcap")
    )


def _bomb_of_messages(box: Box) -> Path:
    path = written(box, 2, compression="message")
    with closing(sqlite3.connect(path / "log.db3", isolation_level=None)) as database:
        database.execute("UPDATE messages SET data = ? WHERE id > 3", (_bomb("zstd"),))
    return path


def _bomb_of_file(box: Box) -> Path:
    path = written(box, 2, compression="file")
    (path / "log.db3.zstd").write_bytes(_bomb("zstd"))
    return path


FILES: dict[str, tuple[str, Callable[[Box], Path]]] = {
    "name-of-url": ("refused", _name_of_url),
    "bomb-lz4": ("refused", lambda box: _bomb_of_ros1(box, "lz4")),
    "bomb-bz2": ("refused", lambda box: _bomb_of_ros1(box, "bz2")),
    "bomb-mcap": ("refused", _bomb_of_mcap),
    "bomb-of-messages": ("refused", _bomb_of_messages),
    "bomb-of-file": ("refused", _bomb_of_file),
    "sound-bz2": ("right", lambda box: written(box, 1, compression="bz2")),
    "sound-lz4": ("right", lambda box: written(box, 1, compression="lz4")),
    "sound-mcap": ("right", lambda box: written(box, 2, storage="mcap")),
    "sound-zstd-mcap": ("right", lambda box: written(box, 2, storage="mcap", compression="storage")),
    "sound-zstd-file": ("right", lambda box: written(box, 2, compression="file")),
    "sound-zstd-messages": ("right", lambda box: written(box, 2, compression="message")),
    "digest-other-ros1": ("refused", lambda box: written(box, 1, digest="0" * 32)),
    "digest-other-ros2": ("refused", lambda box: written(box, 2, digest="RIHS01_" + "0" * 64)),
}


def forged(rng: random.Random) -> Iterable[tuple[str, str, Callable[[Box], Path], tuple[str, ...]]]:
    """Yield name, what has to come of it, what writes the bag, and more options."""
    for name, (expect, kind, change) in MESSAGES.items():
        more = ("recorder.poses=/odometry",) if name.startswith("odometry") else ()
        yield name, expect, functools.partial(written, ros=rng.choice((1, 2)), kind=kind, change=change), more
    for name, (kind, packed) in PACKED.items():
        yield name, "refused", functools.partial(written, ros=2, kind=kind, packed=packed), ()
    for name, text in DEFINITIONS.items():
        yield f"definition-{name}", "right", functools.partial(written, ros=rng.choice((1, 2)), definition=text), ()
    for name, (expect, change) in STATED.items():
        yield f"metadata-{name}", expect, functools.partial(_stated, change=change), ()
    for name, change in TEXTS.items():
        yield f"metadata-{name}", "refused", functools.partial(_text, change=change), ()
    for name, (expect, commands) in TABLES.items():
        yield f"database-{name}", expect, functools.partial(_database, commands=commands), ()
    for name, (expect, make) in FILES.items():
        yield name, expect, make, ()
    for ros in (1, 2):
        yield f"backwards-ros{ros}", "right", functools.partial(_backwards, ros=ros), ()
        for name, topic in (("script", f"/{SCRIPT}"), ("long", "/" + "a" * 2**20)):
            one = functools.partial(_beside, ros=ros, topic=topic)
            yield f"topic-{name}-ros{ros}", "right", one, ()
            yield f"topic-missing-beside-{name}-ros{ros}", "refused", one, ("recorder.poses=/none",)


def cases(seed: int) -> list[Case]:
    """Return all cases of a seed."""
    rng = random.Random(f"{KIND} {seed}")
    found = []
    for name, expect, write, more in forged(rng):

        def make(box: Box, name=name, write=write, expect=expect, more=more) -> list[Opening]:
            bag = write(box)
            found = opened(box, bag, expect, *more, names=("log", "/none"))
            if name.startswith(PREDICTED):
                found.append(Opening(predict_bag(box.base, bag, box.out / "ranges"), expect, ("log",)))
            return found

        found.append(Case(KIND, name, make))
    for kind, place in KINDS.items():
        for name in (*rng.sample(sorted(BROKEN), 5), *rng.sample(sorted(DAMAGED), 3)):
            seed_of_file = rng.random()

            def make_damaged(box: Box, kind=kind, place=place, name=name, seed=seed_of_file) -> list[Opening]:
                bag = written(box, 1 if kind == "ros1" else 2, storage=kind)
                (BROKEN | DAMAGED)[name](box.given / place, random.Random(seed))
                return opened(box, bag, "refused" if name in BROKEN else "either")

            found.append(Case(KIND, f"{kind}-{name}", make_damaged))
    return found
