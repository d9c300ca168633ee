"""A folder of runs as one file: a tar archive compressed by xz, whose bytes follow from the content alone."""

import contextlib
import lzma
import os
import tarfile
from collections.abc import Iterator, Mapping
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory

from omniocc.errors import DataError, UserError, repr_of
from omniocc.io import atomic_file, atomic_write, can_be_in_paths, read_bytes

ENDING = ".tar.xz"
MOST_BYTES = 256 << 20
"""Most bytes that an archive may unpack to, ten times those of the records of this repository."""
MOST_FILES = 20_000
MEMORY_BYTES = 128 << 20
"""Most memory that decompression may take; what `xz -9` wrote needs half of it."""
PART_BYTES = 155
"""Most bytes of a part of a name: the longest that the header of a tar archive holds."""
_BLOCK = tarfile.BLOCKSIZE


def is_archive(path: Path) -> bool:
    """Return whether a path is that of an archive, or the folder that `folder_of` gives in its place."""
    return path.name.endswith(ENDING)


@contextlib.contextmanager
def folder_of(path: Path, to_change: bool = False) -> Iterator[Path]:
    """Give a folder of runs: the path itself or, for an archive, a temporary folder of the same name with its content.

    With `to_change` the archive may be missing, and what the folder holds at the end replaces it. An archive whose
    content stays is not written.

    Raises:
        DataError: when the archive cannot be read or written, or holds anything else than files with plain names.
        UserError: when a file in the folder cannot be in an archive.
    """
    if not is_archive(path):
        yield path
        return
    before = {} if to_change and not os.path.lexists(path) else read_archive(path)
    with TemporaryDirectory() as temporary:
        folder = Path(temporary, path.name)  # messages on its files then name the archive
        folder.mkdir()
        for name, content in before.items():
            with atomic_file(folder / name, flush=False) as file:
                file.write(content)
            os.utime(folder / name, (0, 0))  # no run is the newer one by when it was unpacked
        yield folder
        if to_change and (after := _files_below(folder)) != before:
            try:
                atomic_write(path, archive_of(after))
            except ValueError as error:
                raise UserError(f"{path} cannot hold these runs: {error}") from error


def _files_below(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def read_archive(path: Path) -> dict[str, bytes]:
    """Return the content of every file of an archive by its name.

    Raises:
        DataError: naming the archive and what is wrong in it.
    """
    content = read_bytes(path, most_bytes=MOST_BYTES)
    try:
        return files_of(content)
    except (ValueError, tarfile.TarError, lzma.LZMAError) as error:
        raise DataError(f"{path} is no sound archive of runs: {error}") from error


def archive_of(files: Mapping[str, bytes]) -> bytes:
    """Return the archive of files by name, for equal files the same bytes.

    Files of one kind are neighbours, which compresses them better.

    Raises:
        ValueError: naming the file whose name cannot be in an archive, or when they are too many or too large.
    """
    _check_names(files)
    names = sorted(files, key=lambda name: (PurePosixPath(name).name, name))
    members = [_header(name, len(files[name])) + files[name] + bytes(-len(files[name]) % _BLOCK) for name in names]
    whole = b"".join([*members, bytes(2 * _BLOCK)])
    if len(whole) > MOST_BYTES:
        raise ValueError(f"it would unpack to more than {MOST_BYTES >> 20} MiB")
    return lzma.compress(whole, preset=9 | lzma.PRESET_EXTREME)


def _header(name: str, size: int) -> bytes:
    info = tarfile.TarInfo(name)  # mtime, uid and gid are 0 unless set
    info.size = size
    return info.tobuf(tarfile.USTAR_FORMAT)


def files_of(archive: bytes) -> dict[str, bytes]:
    """Return the files of an archive by name.

    Headers are read one by one: `tarfile` would follow whatever extended headers claim on sizes and names.

    Raises:
        ValueError: naming the member that is no file, has no plain name, stands twice or is longer than the archive;
            also for an archive that is too large or does not end as it should.
        tarfile.TarError: for a damaged header.
        lzma.LZMAError: when it is not compressed by xz, or damaged.
    """
    content = _decompressed(archive)
    found: dict[str, bytes] = {}
    start = 0
    while content[start : start + _BLOCK].strip(b"\0"):
        member = tarfile.TarInfo.frombuf(content[start : start + _BLOCK], "utf-8", "strict")
        begin, end = start + _BLOCK, start + _BLOCK + member.size
        if member.type != tarfile.REGTYPE:
            raise ValueError(f"the member {repr_of(member.name)} is no regular file")
        if member.name in found:
            raise ValueError(f"the member {repr_of(member.name)} stands twice")
        if not begin <= end <= len(content):
            raise ValueError(f"the member {repr_of(member.name)} claims {member.size:,} bytes, which are not there")
        found[member.name] = content[begin:end]
        if len(found) > MOST_FILES:
            break
        start = end + -member.size % _BLOCK
    _check_names(found)
    if start >= len(content) or content[start:].strip(b"\0"):
        raise ValueError("it has no end, or something behind it")
    return found


def _decompressed(archive: bytes) -> bytes:
    decompressor = lzma.LZMADecompressor(lzma.FORMAT_XZ, MEMORY_BYTES)
    content = decompressor.decompress(archive, MOST_BYTES + 1)
    if len(content) > MOST_BYTES:
        raise ValueError(f"it unpacks to more than {MOST_BYTES >> 20} MiB")
    if not decompressor.eof or decompressor.unused_data:
        raise ValueError("it is cut off, or something stands behind its end")
    return content


def _check_names(files: Mapping[str, bytes]) -> None:
    """Raise ValueError for too many files, names that could lead elsewhere, and a file that is a folder of another."""
    if len(files) > MOST_FILES:
        raise ValueError(f"it holds more than {MOST_FILES:,} files")
    for name in files:
        parts = name.split("/")
        if not all(can_be_in_paths(part, PART_BYTES) for part in parts):
            raise ValueError(f"the member {repr_of(name)} has no plain relative name")
        if file := next((str(up) for up in PurePosixPath(name).parents if str(up) in files), None):
            raise ValueError(f"the member {repr_of(file)} is a file, and a folder of {repr_of(name)}")
