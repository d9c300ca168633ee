"""Errors whose message is all a user needs."""


class UserError(ValueError):
    """A mistake or a mishap outside the code: scripts end with this message alone, without a traceback."""
