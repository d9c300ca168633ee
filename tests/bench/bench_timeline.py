"""Megabytes and seconds of a frame on the time line of the Rerun viewer: `python tests/bench/bench_timeline.py SCENES`.

The frames are recorded ones with their true voxels; the truth of the next frame stands for the prediction, and all
occupied cells and their neighbours along the radius for its candidates.
"""

import argparse
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import cv2
from rerun.chunk import RrdReader

from omniocc.extras.viewer.collect import open_shown
from omniocc.extras.viewer.frames import FramePrediction, Shown, ShownFrame
from omniocc.extras.viewer.options import ViewOptions
from omniocc.extras.viewer.scenes import rig_at_sizes
from omniocc.extras.viewer.timeline.log import show
from omniocc.geometry import Cuboid, Cylinder, Grid

GRIDS: dict[str, tuple[Grid, int]] = {
    "tiny, cylinder": (Cylinder((64, 100, 8)), 256),
    "tiny, cuboid": (Cuboid((80, 80, 8)), 256),
    "paper, cylinder": (Cylinder(), 1280),
    "paper, cuboid": (Cuboid(), 1280),
}
"""Grid and width of the images, px."""


def made(shown: Shown, frames: list[ShownFrame], grid: Grid, width: int) -> Shown:
    """Return frames with voxels in a grid and images of a width."""
    given = []
    for frame, following in zip(frames, frames[1:] + frames[:1], strict=True):
        truth, labels = frame.truth[grid], following.truth[grid]
        near = grid.dilate(labels > 0, (1,), ())
        answer = FramePrediction(labels, grid, near, frame.range_m, frame.panorama, None, {"rayiou": 0.5})
        images = tuple(cv2.resize(image, (width, width * 9 // 16)) for image in frame.images)
        rig = rig_at_sizes(frame.rig, images)
        given.append(replace(frame, images=images, rig=rig, truth={grid: truth}, predictions={"model": answer}))
    return replace(shown, models=("model",), grids=(grid,), read=lambda: iter(given))


def parts(path: Path, frames: int) -> str:
    """Return the largest parts of a recording in MB a frame, before it is packed."""
    sizes: dict[str, int] = {}
    for chunk in RrdReader(path).stream():
        _, *places = chunk.entity_path.split("/")
        name = places[2] if len(places) > 2 and places[1] == "ego" else places[0]
        sizes[name] = sizes.get(name, 0) + chunk.to_record_batch().nbytes
    largest = sorted(sizes.items(), key=lambda pair: -pair[1])[:6]
    return ", ".join(f"{name} {size / 1e6 / frames:.2f}" for name, size in largest)


def main() -> None:
    """Print a line for each grid."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scenes", help="recorded scenes: data/virtual-<hash>")
    parser.add_argument("--frames", type=int, default=6)
    options = parser.parse_args()
    chosen = ViewOptions(recorded=options.scenes, limit=options.frames)
    with tempfile.TemporaryDirectory() as folder:
        for name, (grid, width) in GRIDS.items():
            shown = open_shown(chosen, (grid,))
            frames = list(shown)
            path, began_s = Path(folder) / "view.rrd", time.perf_counter()
            show(made(shown, frames, grid, width), path, None)
            seconds, size = time.perf_counter() - began_s, path.stat().st_size
            count = len(frames)
            print(
                f"{name}: {size / 1e6 / count:.2f} MB, {seconds / count:.2f} s a frame; unpacked {parts(path, count)}"
            )


if __name__ == "__main__":
    main()
