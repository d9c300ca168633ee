"""The same test frames across rows, cut out of the sheets that every run leaves in `pictures`."""

import base64
import re
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import cv2
import numpy as np

from omniocc.report.runs import FinishedRun
from omniocc.view.bev import ERRORS
from omniocc.view.canvas import legend
from omniocc.view.compare import class_legend
from omniocc.view.sheet import GAP, MARGIN, column_width

NAME = re.compile(r"test-(\d+)-(.+)-(\d+)\.png")
WEBP_QUALITY = 78


class SheetParts(NamedTuple):
    """What `omniocc.view.comparison` put on a sheet, RGB: from the cameras, in perspective, and from above."""

    cameras: np.ndarray
    truth: np.ndarray
    prediction: np.ndarray
    truth_map: np.ndarray
    prediction_map: np.ndarray
    differences: np.ndarray


class Shown(NamedTuple):
    """One row's answer to a frame; `grid` names its grid where that is another than those of the rows before it."""

    row: str
    run: FinishedRun
    parts: SheetParts
    grid: str


class GalleryFrame(NamedTuple):
    """A test frame and every row's answer to it."""

    scene: str
    frame: str
    shown: Sequence[Shown]


def cut(sheet: np.ndarray) -> SheetParts:
    """Take a sheet apart again.

    Args:
        sheet: (H, W, 3) uint8 RGB, as `omniocc.view.comparison` drew it with a caption.
    """
    inner = sheet.shape[1] - 2 * MARGIN
    half, third = column_width(inner, 2), column_width(inner, 3)
    classes = class_legend(inner)
    errors = legend([(f"Difference: {name}" if k == 0 else name, rgb) for k, (name, rgb) in enumerate(ERRORS)], inner)
    maps = sheet.shape[0] - MARGIN - len(errors) - len(classes) - 2 * GAP - third
    views = maps - GAP - half * 9 // 16
    columns = [MARGIN + k * (third + GAP) for k in range(3)]
    above = [sheet[maps : maps + third, left : left + third] for left in columns]
    sides = [sheet[views : maps - GAP, left : left + half] for left in (MARGIN, MARGIN + half + GAP)]
    return SheetParts(sheet[MARGIN + 24 + GAP : views - GAP, MARGIN : MARGIN + inner], *sides, *above)


def gallery(rows: Mapping[str, Sequence[FinishedRun]]) -> list[GalleryFrame]:
    """Every frame that a row has a picture of, as the first seed of each row saw it."""
    frames: dict[tuple[str, str, str], list[Shown]] = {}
    grids: dict[tuple[str, str, str], list[dict]] = {}
    for row, runs in rows.items():
        geometry = runs[0].config.get("model", {}).get("geometry", {})
        kind = geometry.get("_target_", "grid").split(".")[-1].lower()
        for path in sorted((runs[0].folder / "pictures").glob("test-*.png")):
            sheet, match = cv2.imread(str(path)), NAME.fullmatch(path.name)
            if sheet is None or match is None:
                continue
            key = (match[1], match[2], match[3])
            new = geometry not in grids.setdefault(key, [])
            grids[key].append(geometry)
            parts = cut(cv2.cvtColor(sheet, cv2.COLOR_BGR2RGB))
            frames.setdefault(key, []).append(Shown(row, runs[0], parts, kind if new else ""))
    return [GalleryFrame(key[1], key[2], frames[key]) for key in sorted(frames)]


def inline(picture: np.ndarray, width: int) -> str:
    """The picture at a width, as the address of itself."""
    height = round(picture.shape[0] * width / picture.shape[1])
    small = cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA)
    done, data = cv2.imencode(".webp", cv2.cvtColor(small, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_WEBP_QUALITY, WEBP_QUALITY])
    assert done
    return f"data:image/webp;base64,{base64.b64encode(data.tobytes()).decode()}"
