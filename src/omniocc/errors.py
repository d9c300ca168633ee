"""Errors that scripts report by their message alone."""

import re
import struct
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager

LONGEST = 1000
"""Characters of a text that a message shows: a value may have a thousand lines."""
LONGEST_OF_FILES = 200
"""The same of names and values that a file holds."""
INTERRUPTED = 130
"""Exit code of a process that Ctrl-C has ended, as in shells."""


class UserError(ValueError):
    """A mistake of the user or a problem outside the code: scripts end with this message, without a traceback."""


class DataError(OSError):
    """Recorded data is missing, damaged or cannot be written. The message names the path and the remedy."""


LOADER_ENDED = re.compile(r"DataLoader worker \(pid.*\) (exited unexpectedly|is killed by signal)")
"""PyTorch's message when a process that reads samples is gone."""

FAULTS = (
    ArithmeticError,
    AttributeError,
    EOFError,
    LookupError,
    RuntimeError,
    TypeError,
    ValueError,
    struct.error,
    zipfile.BadZipFile,
    zlib.error,
)
"""What content that is not as expected makes code raise; a reader turns it into one error that names the file."""

ANY_FOLDER = "paths.data=... or paths.runs=..."
"""The keys that an error names for a folder that cannot be written, unless `moved_by` knows the one that helps."""


@contextmanager
def moved_by(key: str) -> Iterator[None]:
    """In errors about the folder to which this block writes, name the key that moves it; the innermost block counts."""
    try:
        yield
    except DataError as error:
        if ANY_FOLDER not in str(error):
            raise
        raise DataError(str(error).replace(ANY_FOLDER, f"{key}=...")) from error


def installing(extra: str) -> str:
    """Return the command that installs a group of optional packages, with the folder in which it works."""
    return f"pip install --constraint constraints.txt --editable '.[{extra}]' (in the folder of this repository)"


def shortened(text: str, most: int = LONGEST) -> str:
    """Return a text for a message, without its middle if it has more than `most` characters."""
    return text if len(text) <= most else f"{text[: most // 2]} ... {text[-most // 2 :]}"


def in_line(text: str) -> str:
    """Return a text of a file for a message: one line, no control characters, shortened."""
    return shortened(text if text.isprintable() else repr(text)[1:-1], LONGEST_OF_FILES)


def reason_of(error: BaseException) -> str:
    """Return what is wrong with content, in one line: the text of a ValueError or OSError, of others their type too."""
    return (
        first_line(error) if isinstance(error, ValueError | OSError) else f"{type(error).__name__}: {first_line(error)}"
    )


def repr_of(value: object) -> str:
    """Return a value for a message, of a long one both ends."""
    return shortened(repr(value), 80)


def first_line(error: BaseException) -> str:
    """Return the first line of an error's text, or the name of its type if it has none."""
    return next(iter(str(error).strip().splitlines()), type(error).__name__)
