"""Errors whose message is all a user needs."""


class UserError(ValueError):
    """A mistake or a mishap outside the code: scripts end with this message alone, without a traceback."""


class DataError(OSError):
    """Recorded data is missing, damaged or cannot be written. The message names the path and the remedy."""
