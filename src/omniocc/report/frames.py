"""The same test frames for all rows, from the parts of sheets that every run saves in `images/parts`."""

import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from omniocc.draw import SheetParts
from omniocc.draw.canvas import fitted
from omniocc.report.html import webp
from omniocc.report.runs import FinishedRun, grid_kind
from omniocc.runs.folder import IMAGES, PARTS

NAME = re.compile(r"test-(\d+)-(.+)-(\d+)")
WEBP_QUALITY = 78


class Shown(NamedTuple):
    """One row's prediction of a frame.

    Attributes:
        row: name of the row.
        run: its first seed.
        parts: images of the sheet.
        grid: kind of the row's grid, empty if an earlier row has the same grid.
    """

    row: str
    run: FinishedRun
    parts: SheetParts
    grid: str


class ComparedFrame(NamedTuple):
    """A test frame and every row's prediction of it."""

    scene: str
    frame: str
    shown: Sequence[Shown]


def compared_frames(rows: Mapping[str, Sequence[FinishedRun]]) -> list[ComparedFrame]:
    """Return all frames with sheets, as the first seed of each row predicts them.

    Runs that saved no parts of their sheets are left out with a message.
    """
    frames: dict[tuple[str, str, str], list[Shown]] = {}
    grids: dict[tuple[str, str, str], list[dict]] = {}
    for row, runs in rows.items():
        geometry = runs[0].config.get("model", {}).get("geometry", {})
        for key, parts in _frames(runs[0].folder / IMAGES):
            new = geometry not in grids.setdefault(key, [])
            grids[key].append(geometry)
            frames.setdefault(key, []).append(Shown(row, runs[0], parts, grid_kind(runs[0].config) if new else ""))
    return [ComparedFrame(key[1], key[2], frames[key]) for key in sorted(frames)]


def _frames(images: Path) -> Iterator[tuple[tuple[str, str, str], SheetParts]]:
    """Yield number, scene and frame of every test frame of a run with its parts."""
    for sheet in sorted(images.glob("test-*.png")):
        folder, match = images / PARTS / sheet.stem, NAME.fullmatch(sheet.stem)
        if match is None:
            continue
        read = {name: cv2.imread(str(folder / f"{name}.png")) for name in SheetParts._fields if folder.is_dir()}
        found = {name: cv2.cvtColor(part, cv2.COLOR_BGR2RGB) for name, part in read.items() if part is not None}
        if missing := [name for name in SheetParts._fields if name not in found]:
            print(f"left out of the compared frames: {folder} lacks {', '.join(missing)}", file=sys.stderr, flush=True)
            continue
        yield (match[1], match[2], match[3]), SheetParts(**found)


def inline(image: np.ndarray, width: int) -> str:
    """Return an RGB image, scaled to a width, as a data URL."""
    return webp(fitted(image, width, cv2.INTER_AREA), WEBP_QUALITY)
