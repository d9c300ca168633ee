"""Which moments have to be lifted, and in which order, so that the wanted ones have their history."""

from collections.abc import Sequence
from typing import Literal, NamedTuple

History = Literal["stream", "window", "none"]
"""`stream`: volumes of past moments are reused. `window`: made anew for every moment. `none`: no past moments."""


class Visit(NamedTuple):
    """One lift.

    Attributes:
        moment: its number.
        wanted: whether its answer is kept.
        reset: whether everything before is to be forgotten.
    """

    moment: int
    wanted: bool
    reset: bool


def schedule(wanted: Sequence[int], frames: int, history: History) -> list[Visit]:
    """Visits in order; just before each wanted moment come the `frames` - 1 before it, as far as there are any.

    Args:
        wanted: moments, increasing.
        frames: of a window, the newest included.
        history: how past moments are had.
    """
    if history == "stream":
        chosen = set(wanted)
        needed = sorted({past for moment in wanted for past in _window(moment, frames)})
        return [Visit(moment, moment in chosen, k == 0) for k, moment in enumerate(needed)]
    length = frames if history == "window" else 1
    return [Visit(past, past == moment, k == 0) for moment in wanted for k, past in enumerate(_window(moment, length))]


def _window(moment: int, frames: int) -> range:
    return range(max(0, moment - frames + 1), moment + 1)
