"""Damage any file, in the ways that need no knowledge of its format."""

import os
import random
import shutil
from collections.abc import Callable
from pathlib import Path

Mutation = Callable[[Path, random.Random], None]


def replaced(change: Callable[[bytes, random.Random], bytes]) -> Mutation:
    """Return a mutation that writes other bytes; the old file, which may be linked elsewhere, stays as it is."""

    def mutate(path: Path, rng: random.Random) -> None:
        content = change(path.read_bytes(), rng)
        path.unlink()
        path.write_bytes(content)

    return mutate


def _somewhere(content: bytes, rng: random.Random, new: Callable[[bytes], bytes], most: int) -> bytes:
    length = min(len(content), most)
    begin = rng.randrange(len(content) - length + 1)
    return content[:begin] + new(content[begin : begin + length]) + content[begin + length :]


def _flipped(content: bytes, rng: random.Random) -> bytes:
    found = bytearray(content)
    for _ in range(max(3, len(content) // 200)):
        found[rng.randrange(len(found))] ^= 1 << rng.randrange(8)
    return bytes(found)


def link_loop(path: Path, rng: random.Random) -> None:
    """Replace the file by a link to a link to the first."""
    path.unlink()
    other = path.with_name(f"{path.name}.loop")
    path.symlink_to(other.name)
    other.symlink_to(path.name)


def link_outward(path: Path, rng: random.Random) -> None:
    """Replace the file by a link to a file of somebody else, which is no such file."""
    path.unlink()
    box = next(parent for parent in path.parents if (parent / "neighbour").is_dir())
    path.symlink_to(os.path.relpath(box / "neighbour" / "notes.txt", path.parent))


def folder(path: Path, rng: random.Random) -> None:
    """Replace the file by an empty folder."""
    path.unlink()
    path.mkdir()


def fifo(path: Path, rng: random.Random) -> None:
    """Replace the file by a pipe that nobody writes to."""
    path.unlink()
    os.mkfifo(path)


BROKEN: dict[str, Mutation] = {
    "empty": replaced(lambda content, rng: b""),
    "cut-in-half": replaced(lambda content, rng: content[: len(content) // 2]),
    "nul-bytes": replaced(lambda content, rng: bytes(len(content))),
    "random-bytes": replaced(lambda content, rng: rng.randbytes(min(len(content), 4096))),
    "folder": folder,
    "fifo": fifo,
    "link-loop": link_loop,
    "link-outward": link_outward,
    "wrong-format": replaced(lambda content, rng: b"\x89HDF\r\n\x1a\n" + b"<html>not found</html>" * 20),
}
"""Mutations after which no file is right."""
DAMAGED: dict[str, Mutation] = {
    "cut-by-a-byte": replaced(lambda content, rng: content[:-1]),
    "cut-somewhere": replaced(lambda content, rng: content[: rng.randrange(1, max(2, len(content)))]),
    "bits-flipped": replaced(_flipped),
    "zeros-somewhere": replaced(lambda content, rng: _somewhere(content, rng, lambda part: bytes(len(part)), 64)),
    "ones-somewhere": replaced(lambda content, rng: _somewhere(content, rng, lambda part: b"\xff" * len(part), 16)),
    "bytes-left-out": replaced(lambda content, rng: _somewhere(content, rng, lambda part: b"", 7)),
    "doubled": replaced(lambda content, rng: content + content),
    "tail-added": replaced(lambda content, rng: content + b"\x00\xff\xfe more"),
}
"""Mutations after which a file may be right, such as a text with another comment."""


def linked_copy(source: Path, target: Path) -> Path:
    """Copy a folder; files are links to the same bytes, which mutations replace and never write to."""
    shutil.copytree(source, target, copy_function=os.link, symlinks=True)
    return target
