"""Size and speed of the viewer's page for recorded scenes, by part and by frame.

    python tests/bench/page_size.py data/virtual-<hash> [--scene train-000-downtown] [--grid cuboid] [--frames 20]

The prediction of a frame is the truth of the frame before it, which is as large as one of a good model. Times are
those of all processes of a headless Chromium with software WebGL, without a graphics card, which a computer with other
work does not change much; without Chromium they are left out.
"""

import argparse
import json
import re
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from omniocc.extras.viewer.collect import show_scenes, with_progress
from omniocc.extras.viewer.frames import FramePrediction, Shown, ShownFrame
from omniocc.extras.viewer.page import write_page
from omniocc.extras.viewer.scenes import recorded_scenes
from omniocc.geometry import Cuboid, Cylinder
from omniocc.runs.table import markdown

sys.path.insert(0, str(Path(__file__).parents[1] / "browser"))
from chromium import ARGUMENTS, find_chromium, processor_s

NAME = "frame before"
TURNED = 40
"""Images that are drawn while the camera turns."""


def predicted(shown: Shown) -> Iterator[ShownFrame]:
    """Yield the frames with the truth of the frame before as the prediction."""
    (grid,), before = shown.grids, None
    for frame in with_progress(shown):
        labels = frame.truth[grid]
        made = FramePrediction(
            before if before is not None else labels, grid, None, frame.range_m, frame.panorama, None, {"rayiou": 0.5}
        )
        before = labels
        yield replace(frame, predictions={NAME: made})


def sizes(path: Path) -> dict[str, float]:
    """Return the kB of every part of a page: for each frame, and once."""
    text = path.read_text("utf-8")
    blocks = {name: len(block) for name, block in re.findall(r'id="(block-\d+)">(.*?)</script>', text)}
    facts = json.loads(re.search(r'id="facts">(.*?)</script>', text)[1])
    frames = facts["frames"]

    def mean_kb(names: list[str]) -> float:
        return sum(blocks[name] for name in names) / len(frames) / 1e3

    cameras = [camera for rig in facts["rigs"] for camera in rig["cameras"]]
    return {
        "images, a frame": mean_kb([image["block"] for frame in frames for image in frame["images"]]),
        "panoramas of ranges, a frame": mean_kb(
            [one["image"]["block"] for frame in frames for one in frame["panoramas"]]
        ),
        "true voxels, a frame": mean_kb([name for frame in frames for name in frame["truth"].values()]),
        "predicted voxels, a frame": mean_kb([frame["predictions"][0]["labels"] for frame in frames]),
        "directions of pixels": sum(blocks[one["directions"]] + blocks[one["valid"]] for one in cameras) / 1e3,
        "three.js and the page's own code": (path.stat().st_size - sum(blocks.values())) / 1e3,
        "the whole file": path.stat().st_size / 1e3,
    }


def speeds(path: Path, frames: int) -> dict[str, float]:
    """Return triangles of a frame, and times in a headless Chromium."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=find_chromium(), args=ARGUMENTS)
        session, page = browser.new_browser_cdp_session(), browser.new_page(viewport={"width": 1440, "height": 900})
        marks = [processor_s(session)]
        page.goto(path.as_uri())
        page.evaluate("omniocc.drawn()")
        marks.append(processor_s(session))
        triangles = [page.evaluate(f"omniocc.show({k}).then(() => omniocc.view3d.triangles())") for k in range(frames)]
        marks.append(processor_s(session))
        page.evaluate(f"omniocc.view3d.measure({TURNED})")
        marks.append(processor_s(session))
        browser.close()
    totals = [sum(counts) for counts in triangles]
    return {
        "triangles of the three views, mean": sum(totals) / len(totals),
        "triangles of the three views, most": max(totals),
        "s of processors to open the page": marks[1] - marks[0],
        "ms of processors to show the next frame": (marks[2] - marks[1]) / frames * 1e3,
        "ms of processors for an image while turning": (marks[3] - marks[2]) / TURNED * 1e3,
    }


def main() -> None:
    """Write a page into a temporary folder and print its figures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("recorded", help="folder of recorded scenes")
    parser.add_argument("--scene", help="one of them")
    parser.add_argument("--grid", choices=("cylinder", "cuboid"), default="cylinder", help="of the paper's size")
    parser.add_argument("--shape", type=int, nargs=3, help="another number of cells along each axis")
    parser.add_argument("--frames", type=int, default=20)
    chosen = parser.parse_args()
    kind = Cylinder if chosen.grid == "cylinder" else Cuboid
    grid = kind(chosen.shape) if chosen.shape else kind()
    scenes = recorded_scenes(chosen.recorded, chosen.scene, None, chosen.frames, "none", None)
    shown = replace(show_scenes(scenes, (), (grid,)), models=(NAME,))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "view.html"
        write_page(shown, predicted(shown), path)
        rows = [[name, f"{kb:,.1f} kB"] for name, kb in sizes(path).items()]
        if find_chromium():
            rows += [[name, f"{value:,.1f}"] for name, value in speeds(path, len(shown)).items()]
    print(markdown(["part", f"{len(shown)} frames, {grid}"], rows))


if __name__ == "__main__":
    main()
