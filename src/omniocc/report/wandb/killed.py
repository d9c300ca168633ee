"""Files of W&B runs that were killed: they may end within a record.

`wandb sync` (0.31) uploads such a file up to there, but never marks it as uploaded, so every call uploads it again.
A file is in LevelDB's log format: after a header, blocks of 32 KiB that hold records or parts of them, each with
checksum, length and kind (https://github.com/google/leveldb/blob/main/doc/log_format.md).
"""

import os
import struct
import time
from pathlib import Path

HEADER_BYTES, BLOCK_BYTES = 7, 32768
PART = struct.Struct("<IHB")
"""Checksum, length and kind of a record or a part of one."""
FULL, LAST = 1, 4
"""Kinds that end a record."""
QUIET_S = 60
"""W&B writes to the file of a run in progress every 15 s."""


def whole_bytes(content: bytes) -> int:
    """Return how many bytes the whole records of a file take, with the header; 0 without any."""
    at, end = HEADER_BYTES, 0
    while at + PART.size <= len(content):
        left = BLOCK_BYTES - at % BLOCK_BYTES
        _, length, kind = PART.unpack_from(content, at) if left >= PART.size else (0, 0, 0)
        if kind == 0:  # padding at the end of a block
            at += left
            continue
        at += PART.size + length
        if at <= len(content) and kind in (FULL, LAST):
            end = at
    return end


def remove_half_record(path: Path) -> None:
    """Cut a file after its last whole record, unless it has been written to in the last minute."""
    end = whole_bytes(path.read_bytes())
    if 0 < end < path.stat().st_size and time.time() - path.stat().st_mtime > QUIET_S:
        os.truncate(path, end)
