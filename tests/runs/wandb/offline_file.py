"""Read back what W&B has written to a run's folder; its Python package (0.31) has no reader.

The file is LevelDB's log format: blocks of 32 KiB, in them parts of records with checksum, length and kind.
"""

import json
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

HEADER_BYTES, BLOCK_BYTES = 7, 32768
PART = struct.Struct("<IHB")
FULL, FIRST, LAST = 1, 2, 4
STEP = "trainer/global_step"


def raw_records(path: Path) -> Iterator[bytes]:
    data = path.read_bytes()
    assert data.startswith(b":W&B")
    at, record = HEADER_BYTES, b""
    while at + PART.size <= len(data):
        left = BLOCK_BYTES - at % BLOCK_BYTES
        _, length, kind = PART.unpack_from(data, at) if left >= PART.size else (0, 0, 0)
        if kind == 0:  # padding at the end of a block
            at += left
            continue
        begin, at = at + PART.size, at + PART.size + length
        assert at <= len(data)
        record = data[begin:at] if kind in (FULL, FIRST) else record + data[begin:at]
        if kind in (FULL, LAST):
            yield record


def records(path: Path) -> Iterator[Any]:
    """Yield W&B's `Record` messages."""
    from wandb.proto import wandb_internal_pb2 as messages

    record_type: Any = vars(messages)["Record"]  # generated when imported

    for content in raw_records(path):
        yield record_type.FromString(content)


def runs_in(path: Path) -> list[Any]:
    """Return the messages that begin a run."""
    return [record.run for record in records(path) if record.WhichOneof("record_type") == "run"]


def history(path: Path) -> Iterator[dict[str, Any]]:
    """Yield rows as logged; objects (images, tables) are dicts."""
    for record in records(path):
        if record.WhichOneof("record_type") != "history":
            continue
        row: dict[str, Any] = {}
        for item in record.history.item:
            key, *inner = item.nested_key or [item.key]
            value = json.loads(item.value_json)
            if inner:
                row.setdefault(key, {})[".".join(inner)] = value
            else:
                row[key] = value
        yield row


def summary(path: Path) -> dict[str, Any]:
    """Return the values that a run gave its summary itself, the last of each key."""
    updates = (record.summary.update for record in records(path) if record.WhichOneof("record_type") == "summary")
    return {".".join(item.nested_key) or item.key: json.loads(item.value_json) for update in updates for item in update}


def files_of(folder: Path) -> list[Path]:
    """Return the files of a run's folder in the order of their start: one for every start of the run."""
    return sorted((folder / "wandb").glob("*run-*/run-*.wandb"), key=lambda path: path.parent.name.split("run-", 1)[1])
