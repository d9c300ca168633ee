"""Bags that anybody may have made are read by the types of ROS, or refused before rosbags believes them."""

import os
import re
import sqlite3
from contextlib import closing
from functools import partial

import cv2
import numpy as np
import pytest
import yaml

pytest.importorskip("rosbags")
from bag_files import BagWriter, write_image
from log_files import START_NS
from rosbags.rosbag2 import CompressionFormat, CompressionMode

from omniocc.errors import DataError, UserError
from omniocc.extras.recorders import bag_reader
from omniocc.extras.recorders.bag import IMAGES, Bag
from omniocc.extras.recorders.messages import FrameTree

PIXELS = np.arange(64 * 36 * 3, dtype=np.uint8).reshape(36, 64, 3)
TOPIC = "/rear/image"


class OwnTypes(BagWriter):
    """A bag whose definitions are given."""

    def __init__(self, path, ros, definition, digest=None):
        super().__init__(path, ros)
        self.definition, self.digest = definition, digest

    def connect(self, topic, kind):
        known = self.store.generate_msgdef(kind)[1] if self.ros == 1 else self.store.hash_rihs01(kind)
        own = {"md5sum" if self.ros == 1 else "rihs01": self.digest or known}
        return self.bag.add_connection(topic, kind, msgdef=self.definition, **own)


class Packed(BagWriter):
    """A bag whose messages or file are compressed."""

    def __init__(self, path, ros, mode):
        super().__init__(path, ros)
        if ros == 1:
            self.bag.set_compression(self.bag.CompressionFormat[mode])
        else:
            self.bag.set_compression(CompressionMode[mode], CompressionFormat.ZSTD)


def write(folder, ros, writer=BagWriter, beside=()):
    path = folder / ("log.bag" if ros == 1 else "log")
    with writer(path, ros) as bag:
        write_image(bag, "rear", START_NS, PIXELS)
        for topic in beside:
            bag.write(topic, "std_msgs/msg/String", START_NS, data="x")
    return path


def read(path):
    with Bag(path) as bag:
        topic = bag.topic("cameras.rear", TOPIC, IMAGES)
        message = bag.message(topic.addresses[0])[0]
    rows = np.asarray(message.data).reshape(message.height, message.step)[:, : 3 * message.width]
    return cv2.cvtColor(rows.reshape(message.height, message.width, 3), cv2.COLOR_BGR2RGB)


def refused(path, *words):
    with pytest.raises(DataError) as caught:
        read(path)
    text = str(caught.value)
    assert all(word in text for word in (str(path), *words)), text
    assert text.isprintable()
    assert len(text) < 1500


def restate(path, change):
    content = yaml.safe_load((path / "metadata.yaml").read_text())
    change(content["rosbag2_bagfile_information"])
    (path / "metadata.yaml").write_text(yaml.safe_dump(content))


def execute(path, commands):
    with closing(sqlite3.connect(path / "log.db3", isolation_level=None)) as database:
        database.executescript(commands)


@pytest.mark.parametrize("ros", [1, 2])
@pytest.mark.parametrize(
    "definition",
    ["sensor_msgs/Image again\n", "uint8[ a = =\n", "geometry_msgs/Point[999999999] points\n", "uint8[] data\n"],
)
def test_messages_are_read_by_the_types_of_ros(tmp_path, ros, definition):
    path = write(tmp_path, ros, partial(OwnTypes, definition=definition))
    assert np.array_equal(read(path), PIXELS)


def test_no_definition_is_parsed(tmp_path):
    path = write(tmp_path, 2)
    text = "module a { const long X = " + "(" * 20 + "1" + ")" * 20 + "; };"  # takes rosbags years
    execute(path, f"UPDATE message_definitions SET encoding = 'ros2idl', encoded_message_definition = '{text}'")
    assert np.array_equal(read(path), PIXELS)


@pytest.mark.parametrize("ros", [1, 2])
def test_types_that_are_not_those_of_ros_are_refused(tmp_path, ros):
    path = write(tmp_path, ros, partial(OwnTypes, definition="uint8[] data\n", digest="0" * 32))
    refused(path, TOPIC, "sensor_msgs/msg/Image", "is not that of ROS")


@pytest.mark.parametrize(("ros", "name"), [(1, "log.bag"), (2, "log/metadata.yaml"), (2, "log/log.db3")])
def test_pipes_are_not_waited_for(tmp_path, ros, name):
    path = write(tmp_path, ros)
    (tmp_path / name).unlink()
    os.mkfifo(tmp_path / name)
    refused(path, str(tmp_path / name), "it is a pipe, not a file")


ENDLESS = "WITH RECURSIVE n(x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM n) SELECT x AS schema_version FROM n"


@pytest.mark.parametrize(
    ("commands", "words"),
    [
        (f"DROP TABLE schema; CREATE VIEW schema AS {ENDLESS} WHERE x < 0", "'schema' is a view"),
        (
            "DROP TABLE schema; CREATE VIRTUAL TABLE schema USING fts5(schema_version)",
            "is a view, or a table whose content is computed",
        ),
        ("ALTER TABLE messages ADD COLUMN more AS (zeroblob(9))", "'messages' is a view, or a table"),
        ("UPDATE messages SET timestamp = 'soon'", "the bag cannot be read"),
        ("UPDATE messages SET data = 'text'", "a message has no bytes, or no time"),
    ],
)
def test_databases_that_compute_or_hold_other_things_are_refused(tmp_path, commands, words):
    path = write(tmp_path, 2)
    execute(path, commands)
    refused(path, words)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda stated: stated.update(message_count=[1]), "are no count of messages"),
        (lambda stated: stated.update(starting_time={"nanoseconds_since_epoch": 0.5}), "are no count of messages"),
        (lambda stated: stated["topics_with_message_count"][0]["topic_metadata"].update(name=5), "5 is no name"),
        (lambda stated: stated.update(relative_file_paths=["%6cog.db3"]), "rename it"),
        (lambda stated: stated.update(storage_identifier="<b>\n\x1b[1m" * 9999), "Storage plugin"),
    ],
)
def test_metadata_of_other_types_are_refused(tmp_path, change, words):
    path = write(tmp_path, 2)
    (path / "%6cog.db3").write_bytes((path / "log.db3").read_bytes())
    restate(path, change)
    refused(path, words)


@pytest.mark.parametrize(
    ("new", "words"),
    [
        ("version: 8\n  version: 3", "the key 'version' is in line 30 already"),
        ("version: !!python/object/apply:os.getcwd []", "python/object/apply:os.getcwd"),
        ("version: " + "[" * 10**5, "nested"),
    ],
)
def test_metadata_are_plain_yaml(tmp_path, new, words):
    path = write(tmp_path, 2)
    place = path / "metadata.yaml"
    place.write_text(place.read_text().replace("version: 8", new))
    refused(path, str(place), words)


@pytest.mark.parametrize(("ros", "mode"), [(1, "BZ2"), (1, "LZ4"), (2, "MESSAGE"), (2, "FILE")])
def test_compressed_bags_are_read_within_a_limit(tmp_path, ros, mode, monkeypatch):
    path = write(tmp_path, ros, partial(Packed, mode=mode))
    assert np.array_equal(read(path), PIXELS)
    monkeypatch.setattr(bag_reader, "MOST_BYTES", 2000)
    monkeypatch.setattr(bag_reader, "MOST_TIMES", 1)
    refused(path, "has more than")


def test_names_of_others_are_shown_in_one_line(tmp_path):
    path = write(tmp_path, 1, beside=("/<script>\n\x1b[31m", "/" + "a" * 10**5))
    with Bag(path) as bag, pytest.raises(UserError, match=r"topics that fit: /rear/image"):
        bag.topic("cameras.rear", "/none", IMAGES)
    with Bag(path) as bag, pytest.raises(UserError) as caught:
        bag.topic("poses", "/none", ("std_msgs/msg/String",))
    text = str(caught.value)
    assert text.isprintable()
    assert len(text) < 500
    assert re.search(r"<script>\\n\\x1b\[31m", text)


def test_a_long_chain_of_frames_is_followed():
    tree = FrameTree()
    step = np.eye(4)
    step[0, 3] = 0.5
    for number in range(20_000):  # quadratic lists of steps would take gigabytes
        tree.add(f"link{number}", f"link{number + 1}", None, step)
    assert tree.fixed("link0", "link20000")[0, 3] == 10_000
    assert tree.fixed("link20000", "link19998")[0, 3] == -1
