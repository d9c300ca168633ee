"""Show frames on a time line: the part of `view.py` that needs the extra `rerun`."""

from contextlib import AbstractContextManager
from pathlib import Path

import rerun as rr

from omniocc.extras.viewer.collect import with_progress
from omniocc.extras.viewer.frames import Shown
from omniocc.extras.viewer.timeline.log import Timeline
from omniocc.extras.viewer.timeline.sinks import to_file, to_own_viewer, to_viewer


def show(shown: Shown, save: Path | None, connect: str | None) -> None:
    """Log all frames to the file `save`, to the viewer at `connect`, or, without both, to one that is started here.

    Raises:
        UserError: when there is no viewer.
        DataError: when the file cannot be written.
    """
    with sink(shown, save, connect) as recording:
        timeline = Timeline(recording, shown.classes, shown.directions, shown.frame_interval_s)
        for frame in with_progress(shown):
            timeline.add(frame)


def sink(shown: Shown, save: Path | None, connect: str | None) -> AbstractContextManager[rr.RecordingStream]:
    """Return the recording that takes the frames."""
    title = ", ".join(shown.models) or shown.source
    if save is not None:
        return to_file(save, title)
    return to_own_viewer(title) if connect is None else to_viewer(connect, title)
