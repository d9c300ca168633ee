"""Write files atomically; check names that become those of files; read text in which every name stands once."""

import contextlib
import errno
import glob
import json
import math
import os
import re
import secrets
import stat
import sys
from collections.abc import Hashable, Iterable, Iterator
from pathlib import Path
from typing import Any, BinaryIO, TypeVar

import yaml
from yaml.constructor import ConstructorError

from omniocc.errors import ANY_FOLDER, DataError, UserError, first_line, repr_of

MOST_BYTES = 16 << 20
"""Largest file of YAML that is read: its content takes many times as much memory."""
MOST_LEVELS = 100
"""Deepest nesting of YAML that is read; the parser in C has no limit of its own and overflows its stack."""
MOST_VALUES = 500_000
"""Most values in a file of YAML, with those that aliases (`*name`) repeat: a few lines can stand for billions."""
LONG_VALUE = 100
"""Characters of a value that count as one more: aliases repeat long texts as well."""

YAML: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
"""Loader of YAML of our own: that of the C library where it is there, which takes an eighth of the time."""
_AS_TEXT = ("tag:yaml.org,2002:merge", "tag:yaml.org,2002:value")  # of the keys << and =, which have no value
Name = TypeVar("Name", bound=Hashable)

NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)(e[-+]?\d+)?", re.ASCII | re.IGNORECASE)
NAME_BYTES = 100
"""Most bytes of a name; those of files and folders, which add to it, may have 255."""
NOT_IN_NAMES = frozenset('/\\<>:"|?*')
"""Characters that separate folders, or that some file system, HTML or a Markdown table takes for its own."""

_REMEDIES = {
    errno.ENOSPC: "the disk is full: free some space",
    errno.EFBIG: "files may not grow that large here: raise the limit (ulimit -f)",
    errno.EDQUOT: "the disk quota is used up: free some space",
    errno.EROFS: f"the folder is read-only: choose another one ({ANY_FOLDER})",
    errno.EACCES: f"the folder may not be written to: choose another one ({ANY_FOLDER})",
    errno.EPERM: f"the folder may not be written to: choose another one ({ANY_FOLDER})",
    errno.ENOLCK: f"its file system has no locks (flock): choose a folder on another one ({ANY_FOLDER})",
    errno.EMFILE: "too many open files: raise the limit (ulimit -n)",
}


def checked_name(what: str, name: object) -> str:
    """Return a name that becomes a part of the path of a file or folder.

    Raises:
        UserError: naming `what` has the name, if it could lead out of its folder, be hidden, or not be written.
    """
    if isinstance(name, str) and can_be_in_paths(name):
        return name
    raise UserError(
        f"{what} is {repr_of(name)}; files are called by it: 1 to {NAME_BYTES} printable characters, none of "
        f"{' '.join(sorted(NOT_IN_NAMES))}, no point first, no space first or last"
    )


def can_be_in_paths(name: str, most_bytes: int = NAME_BYTES) -> bool:
    """Return whether a name can be that of a file or folder: it leads nowhere else and is not hidden."""
    sized = name.isprintable() and 0 < len(name.encode()) <= most_bytes
    return sized and not set(name) & NOT_IN_NAMES and name.strip() == name and not name.startswith(".")


def atomic_write(path: Path, content: bytes | memoryview | str, previous: Path | None = None) -> None:
    """Write a file as `atomic_file` does; `content` is all of it, text is encoded as UTF-8.

    Raises:
        DataError: when the file cannot be written.
    """
    data = content.encode() if isinstance(content, str) else content
    with atomic_file(path, previous, len(data)) as file:
        file.write(data)


@contextlib.contextmanager
def atomic_file(
    path: Path, previous: Path | None = None, needed_bytes: int | None = None, flush: bool = True
) -> Iterator[BinaryIO]:
    """Give a file to write to under a temporary name beside `path`; then flush it to the disk and rename it.

    Readers see the old file or the new one, never a part, whenever the process or the machine stops. The temporary file
    is a new one with a random name: nothing that lies there already, such as a link, is written to.

    Args:
        path: the file; its folder is made if missing.
        previous: new name of the old file in the same folder; None does not keep it. It is renamed just
            before the new file, so that after a stop between the two only this name exists.
        needed_bytes: size of the content, if known, for the message of a full disk.
        flush: whether the file has to outlive a power cut, which takes time.

    Raises:
        DataError: when the file cannot be written; the old file is there, under its own name or that of `previous`, and
            nothing temporary is left.
    """
    temporary = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        descriptor, temporary = _new_file_beside(path)
        with os.fdopen(descriptor, "wb") as file:
            yield file
            file.flush()
            if flush:
                os.fsync(descriptor)
        if previous is not None and path.exists():
            os.replace(path, previous)
        os.replace(temporary, path)
        if flush:
            _flush_folder(path.parent)
    except BaseException as error:
        if temporary is not None:
            with contextlib.suppress(OSError):  # the error that counts is the one before
                temporary.unlink(missing_ok=True)
        if isinstance(error, OSError) and not isinstance(error, DataError):
            raise cannot_write(path, error, needed_bytes) from error
        raise


def _new_file_beside(path: Path) -> tuple[int, Path]:
    """Return the descriptor and name of a new file in the same folder, with the mode that `open` would give it."""
    while True:
        temporary = path.with_name(f".{path.name}.{secrets.token_hex(4)}.tmp")
        with contextlib.suppress(FileExistsError):
            return os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW, 0o666), temporary


def remove_leftovers(path: Path) -> None:
    """Remove temporary files that killed processes left beside `path`; only its single writing process may call it."""
    for leftover in path.parent.glob(f".{glob.escape(path.name)}.*.tmp"):
        leftover.unlink(missing_ok=True)


def check_regular(path: Path) -> None:
    """Check that a path is that of a file with content of its own.

    To read a pipe or a device in its place would wait for ever, or never end.

    Raises:
        FileNotFoundError: when there is nothing, or a link to nothing.
        DataError: for anything else, such as a pipe, a folder, or links that lead in a circle.
    """
    try:
        mode = path.stat().st_mode
    except FileNotFoundError:
        raise
    except OSError as error:
        raise DataError(f"{path} cannot be read: {error.strerror or error}") from error
    if not stat.S_ISREG(mode):
        kind = next((name for test, name in _KINDS if test(mode)), "special file")
        raise DataError(f"{path} cannot be read: it is a {kind}, not a file")


_KINDS = ((stat.S_ISDIR, "folder"), (stat.S_ISFIFO, "pipe"), (stat.S_ISCHR, "device"), (stat.S_ISBLK, "device"))


def cannot_write(path: Path, error: OSError, needed_bytes: int | None = None) -> DataError:
    """Return the error to raise when writing to a file or folder failed; complete files stay valid.

    When the disk is full, the size of the file, if known, is named with the free space, unless it has no inode left.
    """
    reason = _REMEDIES.get(error.errno or 0, f"{error.strerror or error}")
    if error.errno == errno.ENOSPC:
        disk = os.statvfs(next(parent for parent in path.absolute().parents if parent.exists()))
        free_bytes = disk.f_frsize * disk.f_bavail
        if disk.f_files and not disk.f_favail:
            reason = "the disk takes no more files: remove some"
        elif needed_bytes is not None:
            reason += f" ({needed_bytes:,} bytes are needed, {free_bytes:,} are free)"
    remedy = ", then run the same command again; it continues where it stopped" if error.errno in _REMEDIES else ""
    return DataError(f"cannot write {path}: {reason}{remedy}")


def _flush_folder(folder: Path) -> None:
    """Flush a folder to the disk, so that renames in it survive a power cut, where the file system supports it."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    except OSError as error:
        if error.errno != errno.EINVAL:  # some network file systems cannot flush folders
            raise
    finally:
        os.close(descriptor)


def twice(names: Iterable[Name]) -> Name | None:
    """Return the first name that stands there for a second time; None if each stands once."""
    met: set[Name] = set()
    for name in names:
        if name in met:
            return name
        met.add(name)
    return None


def number_of(text: str) -> float:
    """Return the number that a cell or word of a text file is.

    Raises:
        ValueError: if it is no finite number as files have them: Python also reads `1_0` and digits of other scripts.
    """
    if not NUMBER.fullmatch(text.strip()) or not math.isfinite(value := float(text)):
        raise ValueError(f"{repr_of(text)} is no finite number")
    return value


def text_of(content: bytes) -> str:
    """Return the text of UTF-8 without byte-order mark; raise ValueError naming the first line that is no text."""
    try:
        text, wrong = content.decode(), content.find(0)
    except UnicodeDecodeError as error:
        text, wrong = "", error.start
    if wrong >= 0:
        line = content.count(b"\n", 0, wrong) + 1
        raise ValueError(f"it is no text in UTF-8: line {line} holds the byte 0x{content[wrong]:02x}")
    return text.lstrip("\ufeff")


def read_bytes(path: Path, remedy: str = "", most_bytes: int = sys.maxsize) -> bytes:
    """Return the content of a file; raise DataError, with the remedy if it is missing, if it cannot be read."""
    try:
        check_regular(path)
        size = path.stat().st_size
        if size <= most_bytes:
            with contextlib.suppress(MemoryError):
                return path.read_bytes()
    except FileNotFoundError as error:
        raise DataError(f"{path}: the file is missing{remedy and f'; {remedy}'}") from error
    except DataError:
        raise
    except OSError as error:
        raise DataError(f"{path}: the file cannot be read ({error.strerror or error})") from error
    raise DataError(f"{path}: the file has {size:,} bytes, more than can be read")


def read_short_text(path: Path) -> str:
    """Return the text of a file of at most 16 MiB; raise ValueError if it is longer or no text, OSError naming it."""
    check_regular(path)
    try:
        with path.open("rb") as file:
            content = file.read(MOST_BYTES + 1)
    except FileNotFoundError:
        raise
    except OSError as error:
        raise DataError(f"{path} cannot be read: {error.strerror or error}") from error
    if len(content) > MOST_BYTES:
        raise ValueError(f"it has more than {MOST_BYTES >> 20} MiB; is it the right file?")
    return text_of(content)


def read_yaml(path: Path) -> Any:
    """Return the content of a file of YAML, see `parse_yaml`; raise DataError if it is missing, too long or wrong."""
    try:
        return parse_yaml(read_short_text(path))
    except FileNotFoundError as error:
        raise DataError(f"{path}: the file is missing") from error
    except ValueError as error:
        raise DataError(f"{path}: {error}") from error


def parse_yaml(text: str) -> Any:
    """Return the plain data of a text of YAML, also of OpenCV's dialect, whose matrices are mappings.

    Raises:
        ValueError: naming the line that is no YAML, names a key twice, is nested too deeply, or holds other things
            than plain data.
    """
    try:
        if text.lstrip().startswith("%YAML:"):  # OpenCV's header is not valid YAML
            text = text.replace("%YAML:", "#", 1)
        _check_extent(text)
        return yaml.load(text, _Loader)
    except yaml.YAMLError as error:
        raise ValueError(f"the file is not valid YAML: {_reason(error)}") from error


def parse_json(text: str | bytes) -> Any:
    """Return the content of a text of JSON; raise ValueError if it is none, or an object has a key twice."""
    try:
        return json.loads(text, object_pairs_hook=object_of_pairs)
    except RecursionError as error:
        raise ValueError("it is nested too deeply") from error


def object_of_pairs(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Return an object of JSON, as a hook of its decoder; raise ValueError naming the key that stands there twice."""
    found = dict(pairs)
    if len(found) < len(pairs):
        raise ValueError(f"the key {twice(key for key, _ in pairs)!r} stands twice in one object; keep one")
    return found


def _reason(error: yaml.YAMLError) -> str:
    """Return what is wrong with a text of YAML, and in which line, in one line."""
    if not isinstance(error, yaml.MarkedYAMLError) or error.problem_mark is None:
        return first_line(error)
    reason = ", ".join(part for part in (error.context, error.problem) if part)
    return f"line {error.problem_mark.line + 1}: {reason}"


def _check_extent(text: str) -> None:
    """Raise YAMLError where a text of YAML is nested too deeply or holds too much, or an alias repeats itself."""
    values = 0  # with all that aliases stand for
    begun: list[tuple[str | None, int, list[int]]] = []  # anchor, values before, levels of its parts
    known: dict[str | None, tuple[int, int]] = {}  # values and levels, by anchor
    for event in yaml.parse(text, YAML):
        problem, size, levels = None, 0, 0
        if isinstance(event, yaml.AliasEvent):
            if event.anchor in (anchor for anchor, _, _ in begun):
                problem = f"'*{event.anchor}' stands in itself"
            size, levels = known.get(event.anchor, (0, 0))
        elif isinstance(event, yaml.CollectionStartEvent):
            begun.append((event.anchor, values, [0]))
            size = 1
        elif isinstance(event, yaml.CollectionEndEvent):
            anchor, before, parts = begun.pop()
            levels = max(parts) + 1
            known[anchor] = values - before, levels
        elif isinstance(event, yaml.ScalarEvent):
            size = 1 + len(event.value) // LONG_VALUE
            known[event.anchor] = size, 0
        values += size
        if begun:
            begun[-1][2].append(levels)
        if values > MOST_VALUES:
            problem = f"it holds more than {MOST_VALUES:,} values, with those that aliases (*name) repeat"
        if len(begun) + levels > MOST_LEVELS:
            problem = f"it is nested in more than {MOST_LEVELS} levels"
        if problem is not None:
            raise ConstructorError(problem=problem, problem_mark=event.start_mark)


class _Loader(YAML):
    """Loader of plain data that refuses a key that stands twice in a mapping; others keep the last value."""

    def get_single_data(self) -> Any:
        """Return the content of the only document, None if there is none; raise YAMLError if it is wrong."""
        root = self.get_single_node()
        for node in _mappings(root):  # before `<<` is resolved: keys beside it may override what it brings
            lines: dict[Any, int] = {}
            for key, _ in node.value:
                name = key.value if key.tag in _AS_TEXT else self.construct_object(key, deep=True)
                if isinstance(name, Hashable) and name in lines:
                    problem = f"the key {name!r} is in line {lines[name]} already; keep one"
                    raise ConstructorError(problem=problem, problem_mark=key.start_mark)
                if isinstance(name, Hashable):
                    lines[name] = key.start_mark.line + 1
        return None if root is None else self.construct_document(root)

    def construct_object(self, node: Any, deep: bool = False) -> Any:
        """Return the value of a node; raise YAMLError if there is none, as of the date 2024-13-45."""
        try:
            value = super().construct_object(node, deep)
            if isinstance(value, int):
                str(value)  # ValueError for thousands of hexadecimal digits, which no message could show
            return value
        except (AttributeError, KeyError, ValueError) as error:
            problem = f"{repr_of(node.value)} is no {node.tag.rpartition(':')[2]}"
            raise ConstructorError(problem=problem, problem_mark=node.start_mark) from error


def _refuse_tag(_: Any, node: Any) -> Any:
    raise ConstructorError(problem=f"the tag {node.tag!r} is none of plain data", problem_mark=node.start_mark)


_Loader.add_constructor(None, _refuse_tag)
_Loader.add_constructor("tag:yaml.org,2002:opencv-matrix", _Loader.construct_yaml_map)


def _mappings(root: Any) -> Iterator[Any]:
    """Yield every mapping below a node of YAML once."""
    waiting, met = [root], set()
    while waiting:
        node = waiting.pop()
        if id(node) in met or not isinstance(node, yaml.CollectionNode):
            continue
        met.add(id(node))
        if isinstance(node, yaml.MappingNode):
            yield node
            waiting += [part for pair in node.value for part in pair]
        else:
            waiting += node.value
