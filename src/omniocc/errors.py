"""Errors that scripts report by their message alone."""


class UserError(ValueError):
    """A mistake of the user or a problem outside the code: scripts end with this message, without a traceback."""


class DataError(OSError):
    """Recorded data is missing, damaged or cannot be written. The message names the path and the remedy."""


def installing(extra: str) -> str:
    """Return the command that installs a group of optional packages, with the folder in which it works."""
    return f"pip install --constraint constraints.txt --editable '.[{extra}]' (in the folder of this repository)"


def first_line(error: BaseException) -> str:
    """Return the first line of an error's text, or the name of its type if it has none."""
    return next(iter(str(error).strip().splitlines()), type(error).__name__)
