"""Recorders of scenes from outside of the virtual world: a CARLA server, or the logs of a car.

All write the same format (`omniocc.data.store`), which `data=recorded` reads.
"""

from collections.abc import Sequence
from typing import NamedTuple, Protocol, runtime_checkable


class Finding(NamedTuple):
    """One assumption: what it says, whether it holds, and what was measured."""

    name: str
    holds: bool
    measured: str


@runtime_checkable
class Checks(Protocol):
    """A recorder that can check what it records from."""

    def check(self) -> Sequence[Finding]:
        """Return every assumption about the recordings with what was measured."""
        ...
