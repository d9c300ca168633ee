"""The page in which the voxels of a dataset's frames can be turned, beside the page to browse them."""

from collections.abc import Sequence
from pathlib import Path

from omniocc.data.store.reader import SceneReader
from omniocc.extras.viewer.collect import show_scenes, with_progress
from omniocc.extras.viewer.page import write_page
from omniocc.extras.viewer.scenes import scenes_of
from omniocc.geometry import Grid


def save_viewer_page(
    path: Path, frames: Sequence[tuple[SceneReader, Sequence[int]]], geometry: Grid, image_px: int
) -> None:
    """Write the page with these frames of each scene; images are at most `image_px` wide.

    Raises:
        DataError: when a scene is damaged or the disk refuses.
    """
    scenes = scenes_of(frames, path.parent)
    shown = show_scenes(scenes, (), (geometry,))
    write_page(shown, with_progress(shown), path, image_px)
