"""Make the documentation's pictures: `make pictures`, or `python tools/pictures.py [folder of surround_view]`.

Voxels are predicted for a recorded test frame of the weights `tiny`, so only the picture of the virtual world is
rendered. The folder holds the four images of the rig `surround_view`, which are not part of this repository; without it
the two pictures of a real car stay as they are. It takes two minutes on a CPU core.
"""

import io
import math
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
import torch
from PIL import Image

from omniocc.camera import Rig
from omniocc.classes import ClassTable
from omniocc.data.store.reader import SceneReader
from omniocc.draw import comparison_parts, comparison_sheet, render_voxels
from omniocc.draw.canvas import Labels, class_legend, encode_image, fitted
from omniocc.draw.sheet import camera_rows, column_width, inner_width, row, stack
from omniocc.geometry import Grid
from omniocc.io import atomic_write
from omniocc.predict import load
from omniocc.predict.input.sequence import RecordedSequence
from omniocc.predict.predictor import STEPS, Input, Predictor
from omniocc.predict.stopwatch import Stopwatch
from omniocc.runs.script import quiet_libraries
from omniworld import Scene

ROOT = Path(__file__).parents[1]
PICTURES = ROOT / "docs" / "pictures"
WEIGHTS, SCENE, FRAME = "tiny", "test-000-oldtown", 0
CAPTION = f"weights '{WEIGHTS}', scene {SCENE} of the virtual world, which training never saw"
JPEG = (cv2.IMWRITE_JPEG_QUALITY, 84)

WIDTH_PX, VIEW_DEG, COLORS = 800, 56.0, 192
"""Width and colours of the moving picture, and the field of view of its voxels."""
TURNS, TURN_MS = 45, 160
EYE_M = (28.0, 22.0)
"""Distance of the eye from the vertical axis of the car, and its height above the ego origin."""

WEATHERS = {
    "downtown": "dusk",
    "suburb": "clear",
    "industrial": "rain",
    "countryside": "clear",
    "oldtown": "overcast",
    "arterial": "clear",
    "campus": "clear",
    "roundabout": "fog",
}
"""Weather of every theme in the picture of the virtual world."""


class Predicted(NamedTuple):
    """A recorded frame: RGB images of the cameras, true and predicted labels of the grid's cells, and their classes."""

    images: list[np.ndarray]
    true: Labels
    predicted: Labels
    grid: Grid
    classes: ClassTable


def predicted_frame() -> Predicted:
    """Return the frame with its prediction, as `make demo` draws it: also where no camera sees."""
    trained, scene = load(WEIGHTS), SceneReader(ROOT / "tests" / "weights" / WEIGHTS / SCENE)
    images, facts, grid = scene.images(FRAME), trained.facts, trained.occupancy.geometry
    predictor = Predictor(trained.occupancy, facts.width_for(scene.rig), (), device := torch.device("cpu"), None)
    found = predictor.step(Input(*predictor.scaled(images, scene.rigs[FRAME])), Stopwatch(device, STEPS))
    truth = RecordedSequence(scene, (FRAME,)).truth(FRAME, grid, facts.ignore)
    assert truth is not None
    return Predicted(images, truth.voxels[0], found.labels, grid, facts.classes)


def moving_voxels(frame: Predicted) -> None:
    """Write images of six fisheyes above true and predicted voxels that turn, as a GIF that repeats."""
    width = inner_width(WIDTH_PX)
    cameras, names = camera_rows(frame.images, width), class_legend(frame.classes, width)
    view_px, sheets = column_width(width, 2), []
    for turn in range(TURNS):
        angle = 2 * math.pi * turn / TURNS
        eye_m = (-EYE_M[0] * math.cos(angle), -EYE_M[0] * math.sin(angle), EYE_M[1])
        views = [
            render_voxels(labels, frame.grid, frame.classes, view_px, view_px * 5 // 8, eye_m, view_deg=VIEW_DEG)
            for labels in (frame.true, frame.predicted)
        ]
        sheets.append(stack([*cameras, row(views, ("true voxels", "predicted"), width), names], WIDTH_PX, CAPTION))
    atomic_write(PICTURES / "voxels.gif", gif(sheets))


def demo_sheet(frame: Predicted) -> None:
    """Write images, true and predicted voxels of a frame, and their differences."""
    parts = comparison_parts(np.stack(frame.images), frame.true, frame.predicted, frame.grid, frame.classes)
    write_jpeg("demo.jpg", comparison_sheet(parts, frame.classes, CAPTION), 1280)


def gif(sheets: Sequence[np.ndarray]) -> bytes:
    """Return images of one size as the bytes of a GIF with the colours of the first one."""
    palette = Image.fromarray(sheets[0]).quantize(COLORS)
    first, *others = (Image.fromarray(sheet).quantize(palette=palette, dither=Image.Dither.NONE) for sheet in sheets)
    file = io.BytesIO()
    first.save(file, "gif", save_all=True, append_images=others, duration=TURN_MS, loop=0, optimize=False)
    return file.getvalue()


def world_sheet() -> None:
    """Write the image of the front camera in each theme of the virtual world."""
    rig = Rig.load("fisheye6").resized(480, 270)
    images = [Scene(theme, 4, rig, weather=weather).frame(0).images[0] for theme, weather in WEATHERS.items()]
    names = [f"{theme}, {weather}" for theme, weather in WEATHERS.items()]
    write_jpeg("world.jpg", stack(camera_rows(images, inner_width(994), 2, names), 994), 994)


def real_car(folder: Path) -> None:
    """Write what `rig.py show` and `predict.py depth` draw of the four images of a real car."""
    with tempfile.TemporaryDirectory() as place:
        rig, images = "surround_view", f"images={folder}"
        script("rig.py", "show", rig, images, f"output={place}/rig.png")
        script("predict.py", "depth", f"rig={rig}", images, f"output={place}/ranges")
        (overview,) = Path(place, "ranges").rglob("overview.png")
        for name, source in (("rig_show.jpg", Path(place, "rig.png")), ("predict_any_rig.jpg", overview)):
            write_jpeg(name, np.asarray(Image.open(source).convert("RGB")), 900)


def write_jpeg(name: str, image: np.ndarray, width: int) -> None:
    """Write an RGB image as a JPEG file of a width, px."""
    atomic_write(PICTURES / name, encode_image(fitted(image, width), "jpg", JPEG))


def script(name: str, *arguments: str) -> None:
    """Run a script of `src`, or one of `tools`."""
    folder = "src" if (ROOT / "src" / name).is_file() else "tools"
    subprocess.run([sys.executable, f"{folder}/{name}", *arguments], cwd=ROOT, check=True)


def main(folder: Path | None) -> None:
    """Write all pictures but the screenshots of the viewer, which `tests/browser/test_screenshots.py` takes."""
    quiet_libraries()
    frame = predicted_frame()
    moving_voxels(frame)
    demo_sheet(frame)
    world_sheet()
    script("draw_rays.py", str(PICTURES / "rays.png"))
    if folder is not None:
        real_car(folder.resolve())


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else None)
