"""Scenes, predictions and runs in progress for people to look at: in Rerun, in a page, in a browser."""

from omniocc.viewer.collect import open_shown
from omniocc.viewer.frames import FramePrediction, Shown, ShownFrame
from omniocc.viewer.options import ViewOptions

__all__ = ["FramePrediction", "Shown", "ShownFrame", "ViewOptions", "open_shown"]
