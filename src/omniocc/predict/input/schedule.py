"""The order in which frames are lifted, so that every wanted frame has its history."""

from collections.abc import Sequence
from typing import Literal, NamedTuple

History = Literal["stream", "window", "none"]
"""`stream`: volumes of past frames are reused. `window`: they are computed again for every frame. `none`: no past."""


class Lift(NamedTuple):
    """One frame to be lifted.

    Attributes:
        frame: its index.
        wanted: whether its prediction is kept.
        reset: whether the history is cleared before it.
    """

    frame: int
    wanted: bool
    reset: bool


def schedule(wanted: Sequence[int], window: int, history: History) -> list[Lift]:
    """Return the frames to lift, in order, so that the frames with the increasing indices `wanted` can be predicted.

    Each of these directly follows the `window` - 1 frames before it, or as many as the sequence has: the model fuses
    `window` frames, the newest included.
    """
    if history == "stream":
        chosen = set(wanted)
        needed = sorted({past for frame in wanted for past in _window(frame, window)})
        return [Lift(frame, frame in chosen, k == 0) for k, frame in enumerate(needed)]
    length = window if history == "window" else 1
    return [Lift(past, past == frame, k == 0) for frame in wanted for k, past in enumerate(_window(frame, length))]


def _window(frame: int, length: int) -> range:
    return range(max(0, frame - length + 1), frame + 1)
