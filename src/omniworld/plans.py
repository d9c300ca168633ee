"""Scenes of the virtual world before they are rendered."""

from typing import NamedTuple, Protocol, runtime_checkable

from omniocc.data.source import Split
from omniocc.frame import Frame


class ScenePlan(NamedTuple):
    """A scene that is to be rendered: its name, split, kind of place, and the seed of everything random in it."""

    name: str
    split: Split
    theme: str
    seed: int


@runtime_checkable
class Recordable(Protocol):
    """A scene that can be recorded frame by frame, such as `omniworld.Scene`."""

    def frame(self, index: int) -> Frame:
        """Return the frame with this number; it depends on nothing but the scene and the number."""
        ...
