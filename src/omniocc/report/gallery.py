"""The same test frames across rows, from the parts of sheets that every run leaves in `images/parts`."""

import base64
import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from omniocc.report.runs import FinishedRun
from omniocc.run.folder import IMAGES, PARTS
from omniocc.view import SheetParts

NAME = re.compile(r"test-(\d+)-(.+)-(\d+)")
WEBP_QUALITY = 78


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


def gallery(rows: Mapping[str, Sequence[FinishedRun]]) -> list[GalleryFrame]:
    """Return every frame that a row has pictures of, as the first seed of each row saw it.

    Runs that saved no parts of their pictures are left out with a line that says so.
    """
    frames: dict[tuple[str, str, str], list[Shown]] = {}
    grids: dict[tuple[str, str, str], list[dict]] = {}
    for row, runs in rows.items():
        geometry = runs[0].config.get("model", {}).get("geometry", {})
        kind = geometry.get("_target_", "grid").split(".")[-1].lower()
        for key, parts in _frames(runs[0].folder / IMAGES):
            new = geometry not in grids.setdefault(key, [])
            grids[key].append(geometry)
            frames.setdefault(key, []).append(Shown(row, runs[0], parts, kind if new else ""))
    return [GalleryFrame(key[1], key[2], frames[key]) for key in sorted(frames)]


def _frames(pictures: Path) -> Iterator[tuple[tuple[str, str, str], SheetParts]]:
    """Yield number, scene and frame of every test frame of a run with its parts."""
    for sheet in sorted(pictures.glob("test-*.png")):
        folder, match = pictures / PARTS / sheet.stem, NAME.fullmatch(sheet.stem)
        if match is None:
            continue
        read = {name: cv2.imread(str(folder / f"{name}.png")) for name in SheetParts._fields if folder.is_dir()}
        found = {name: cv2.cvtColor(part, cv2.COLOR_BGR2RGB) for name, part in read.items() if part is not None}
        if missing := [name for name in SheetParts._fields if name not in found]:
            print(f"left out of the gallery: {folder} lacks {', '.join(missing)}", file=sys.stderr, flush=True)
            continue
        yield (match[1], match[2], match[3]), SheetParts(**found)


def inline(picture: np.ndarray, width: int) -> str:
    """The picture at a width, as the address of itself."""
    height = round(picture.shape[0] * width / picture.shape[1])
    small = cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA)
    done, data = cv2.imencode(".webp", cv2.cvtColor(small, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_WEBP_QUALITY, WEBP_QUALITY])
    assert done
    return f"data:image/webp;base64,{base64.b64encode(data.tobytes()).decode()}"
