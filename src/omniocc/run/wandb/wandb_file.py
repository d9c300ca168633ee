"""What W&B has written to a run's folder; W&B's own reader is no part of its Python package any more.

The file is LevelDB's log format: blocks of 32 KiB, in them parts of records with checksum, length and kind.
"""

import json
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from omniocc.errors import UserError

MAGIC = b":W&B"
HEADER_BYTES, BLOCK_BYTES = 7, 32768
PART = struct.Struct("<IHB")
FULL, FIRST, LAST = 1, 2, 4
STEP = "trainer/global_step"


def raw_records(path: Path) -> Iterator[bytes]:
    """Serialised records in the order written, up to where the writer was killed.

    Raises:
        UserError: when it is no file of W&B.
    """
    data = path.read_bytes()
    if data and data[: len(MAGIC)] != MAGIC:
        raise UserError(f"{path} is not a W&B file; move it elsewhere")
    at, record = HEADER_BYTES, b""
    while at + PART.size <= len(data):
        left = BLOCK_BYTES - at % BLOCK_BYTES
        _, length, kind = PART.unpack_from(data, at) if left >= PART.size else (0, 0, 0)
        if kind == 0:  # the rest of a block in which no part began
            at += left
            continue
        begin, at = at + PART.size, at + PART.size + length
        if at > len(data):
            return
        record = data[begin:at] if kind in (FULL, FIRST) else record + data[begin:at]
        if kind in (FULL, LAST):
            yield record


def records(path: Path) -> Iterator[Any]:
    """W&B's `Record` messages."""
    from wandb.proto import wandb_internal_pb2 as messages

    record_type: Any = vars(messages)["Record"]  # generated when imported

    for content in raw_records(path):
        yield record_type.FromString(content)


def history(path: Path) -> Iterator[dict[str, Any]]:
    """Rows as logged, decoded; what was logged as an object (a picture, a table) is a dict."""
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


def files_of(folder: Path) -> list[Path]:
    """The files of a run's folder in the order of their beginning: one for every time it was started."""
    return sorted((folder / "wandb").glob("*run-*/run-*.wandb"), key=lambda path: path.parent.name.split("run-", 1)[1])


def logged(folder: Path) -> set[tuple[int, str]]:
    """Step and key of everything that a run has logged before."""
    return {(row[STEP], key) for path in files_of(folder) for row in history(path) if STEP in row for key in row}
