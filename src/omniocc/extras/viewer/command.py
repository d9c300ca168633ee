"""The commands of `src/view.py`: show frames in the Rerun viewer, or write them to a file or a page."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from omniocc.errors import UserError, installing
from omniocc.extras.viewer.options import TargetOptions, ViewOptions
from omniocc.extras.viewer.watch.files import config_of

if TYPE_CHECKING:
    from omniocc.extras.viewer.frames import Shown


def view(options: ViewOptions | None, target: TargetOptions) -> None:
    """Show the frames that the options choose; without options, follow runs in progress.

    Raises:
        UserError: naming the option or package that is missing.
    """
    if options is None:
        from omniocc.extras.viewer.watch.server import watch  # starts at once, without torch

        watch(Path(str(target.watch)), target.port)
        return
    what = options.run or [options.recorded or options.predictions]
    print(f"loading {', '.join(map(str, what))}", flush=True)  # the imports below take seconds
    path = show_frames(options, target)
    if path is not None and target.wandb:
        from omniocc.runs.wandb.loggers import log_file

        folder = Path(options.run[0])
        log_file(folder, path, config_of(folder)[0].get("logger", {}).get("project", "omniocc"))
        print(f"{path} is kept in {folder}/wandb; upload it by: make wandb-sync")


def show_frames(options: ViewOptions, target: TargetOptions) -> Path | None:
    """Show the frames and return the file that they were written to; None if a viewer shows them."""
    if target.page:
        return show_page(options, target)
    try:
        from omniocc.extras.viewer.timeline.log import show
        from omniocc.extras.viewer.timeline.sinks import check_place
    except ImportError as error:
        raise UserError(f"the Rerun viewer needs one more package: {installing('rerun')}") from error
    path = None if target.save is None else Path(target.save)
    check_place(path, target.connect)
    show(open_frames(options), path, target.connect)
    if path is not None:
        print(f"{path}: {path.stat().st_size / 1e6:.1f} MB; open it by: rerun {path}")
    return path


def show_page(options: ViewOptions, target: TargetOptions) -> Path:
    """Write the frames to a page and return its path."""
    from omniocc.extras.viewer.collect import with_progress
    from omniocc.extras.viewer.page import page_path, write_page

    path, frames = page_path(target.output, options.run), open_frames(options)
    write_page(frames, with_progress(frames), path)
    print(f"{path}: {path.stat().st_size / 1e6:.1f} MB\n{path.resolve().as_uri()}")
    return path


def open_frames(options: ViewOptions) -> "Shown":
    """Return the frames that the options choose, and print where they come from."""
    from omniocc.extras.viewer.collect import open_shown

    frames = open_shown(options)
    print(f"{frames.source}: {len(frames)} frames; the first one takes longest", flush=True)
    return frames


@contextmanager
def open_viewer(viewer: str | None, title: str, stream: Literal["RangeStream", "VoxelStream"]) -> Iterator[Any]:
    """Yield a stream of predicted frames into a Rerun viewer; None without a viewer.

    Raises:
        UserError: when Rerun is not installed.
    """
    if viewer is None:
        yield None
        return
    try:
        from omniocc.extras.viewer.timeline import stream as streams
    except ImportError as error:
        raise UserError(f"viewer=... needs one more package: {installing('rerun')}") from error
    with streams.to_viewer(viewer, title) as recording:
        yield getattr(streams, stream)(recording)
