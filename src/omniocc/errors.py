"""Errors that scripts report by their message alone."""

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


def installing(extra: str) -> str:
    """Return the command that installs a group of optional packages, with the folder in which it works."""
    return f"pip install --constraint constraints.txt --editable '.[{extra}]' (in the folder of this repository)"


def shortened(text: str, most: int = LONGEST) -> str:
    """Return a text for a message, without its middle if it has more than `most` characters."""
    return text if len(text) <= most else f"{text[: most // 2]} ... {text[-most // 2 :]}"


def in_line(text: str) -> str:
    """Return a text of a file for a message: one line, no control characters, shortened."""
    return shortened(text if text.isprintable() else repr(text)[1:-1], LONGEST_OF_FILES)


def repr_of(value: object) -> str:
    """Return a value for a message, of a long one both ends."""
    return shortened(repr(value), 80)


def first_line(error: BaseException) -> str:
    """Return the first line of an error's text, or the name of its type if it has none."""
    return next(iter(str(error).strip().splitlines()), type(error).__name__)
