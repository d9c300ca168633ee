"""Pictures of the cameras of a rig: which file is whose, and do they fit the calibration?"""

import math
import re
from collections.abc import Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
import torch
from jaxtyping import Float32
from torch import Tensor

from omniocc.camera import Camera, Rig
from omniocc.errors import UserError

ENDINGS = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp", ".ppm")
SHAPE_TOLERANCE = 0.01
"""By which width / height of a picture may differ from the calibration's: rounding of a scaled picture."""


class Frame(NamedTuple):
    """One moment: a file per camera, None for those left out."""

    name: str
    files: tuple[Path | None, ...]


def find_frames(images: str | Sequence[str], rig: Rig, without: Sequence[str] = ()) -> list[Frame]:
    """Files of every camera of the rig.

    Args:
        images: a folder with one picture per camera, named as the camera; or a folder of such folders, one per moment;
            or one file per camera, in the rig's order.
        rig: the cameras.
        without: names of cameras to do without; their files need not be there.

    Raises:
        UserError: naming what is missing, superfluous or misspelt.
    """
    check_without(without, rig)
    if not isinstance(images, str):
        return [_listed([Path(path) for path in images], rig, without)]
    folder = Path(images)
    if not folder.is_dir():
        hint = "; give a folder, or a list with one picture per camera: images=[a.png,b.png]" * folder.exists()
        raise UserError(f"images={images}: there is no such folder{hint}")
    moments = sorted((path for path in folder.iterdir() if path.is_dir() and _pictures(path)), key=_in_time)
    if _pictures(folder) or not moments:
        return [Frame("", _named(folder, rig, without))]
    return [Frame(moment.name, _named(moment, rig, without)) for moment in moments]


def check_without(without: Sequence[str], rig: Rig) -> None:
    """Names of cameras to do without must be some of the rig's, not all.

    Raises:
        UserError: naming the one that is not, and those there are.
    """
    for name in without:
        if name not in rig.names:
            raise UserError(f"without={name}: no such camera{_near(name, rig.names)}; cameras: {', '.join(rig.names)}")
    if len(set(without)) == len(rig.names):
        raise UserError("every camera is left out; leave some in")


def _in_time(moment: Path) -> list[tuple[int, str]]:
    """Names in the order of the numbers in them: 9 before 10."""
    return [(int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", moment.name)]


def _listed(paths: list[Path], rig: Rig, without: Sequence[str]) -> Frame:
    if len(paths) != len(rig.names):
        names = ", ".join(rig.names)
        raise UserError(f"{len(paths)} images for {len(rig.names)} cameras; give one each, in this order: {names}")
    for path, name in zip(paths, rig.names, strict=True):
        if not path.is_file() and name not in without:
            raise UserError(f"there is no image {path} (camera '{name}')")
    return Frame("", tuple(None if name in without else path for path, name in zip(paths, rig.names, strict=True)))


def _named(folder: Path, rig: Rig, without: Sequence[str]) -> tuple[Path | None, ...]:
    pictures = _pictures(folder)
    files: list[Path | None] = []
    for name in rig.names:
        mine = [path for path in pictures if path.stem == name]
        if name in without:
            files.append(None)
            continue
        if len(mine) != 1:
            raise UserError(
                _not_one(folder, name, mine, [path.stem for path in pictures if path.stem not in rig.names])
            )
        files.append(mine[0])
    return tuple(files)


def _not_one(folder: Path, name: str, mine: list[Path], others: list[str]) -> str:
    if mine:
        return f"{folder}: several images of camera '{name}': {', '.join(path.name for path in mine)}; leave one"
    others_text = f"; there are images of no camera of the rig: {', '.join(sorted(others)[:8])}" if others else ""
    return (
        f"{folder}: no image of camera '{name}' (a file {name}.png or {name}.jpg)"
        f"{_near(name, others)}{others_text}; without=[{name}] does without it"
    )


def _near(name: str, others: Sequence[str]) -> str:
    close = get_close_matches(name, others, n=1)
    return f" (is it '{close[0]}'?)" if close else ""


def _pictures(folder: Path) -> list[Path]:
    return sorted(path for path in folder.iterdir() if path.is_file() and path.suffix.lower() in ENDINGS)


def read_frame(frame: Frame, rig: Rig) -> list[np.ndarray]:
    """(H, W, 3) uint8 RGB of every camera, as large as the file; black and as large as the rig's for one left out.

    Raises:
        UserError: naming the file that cannot be read or has another shape than its camera's calibration.
    """
    return [_read(file, rig, k) for k, file in enumerate(frame.files)]


def _read(file: Path | None, rig: Rig, k: int) -> np.ndarray:
    camera = rig.cameras[k]
    if file is None:
        return np.zeros((camera.height, camera.width, 3), np.uint8)
    # as the sensor gave it: a calibration does not know of an orientation tag
    image = cv2.imread(str(file), cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
    if image is None:
        raise UserError(f"{file} is damaged, or no image")
    height, width = image.shape[:2]
    if abs(width / height / (camera.width / camera.height) - 1) > SHAPE_TOLERANCE:
        raise UserError(
            f"{file} is {width}x{height} px but camera '{rig.names[k]}' is calibrated for "
            f"{camera.width}x{camera.height} px: a scaled picture will do, a cropped one needs its own calibration"
        )
    return cv2.cvtColor(image, cv2.COLOR_BGR2RGB)


def resized_to_width(
    images: Sequence[np.ndarray], rig: Rig, width: int | None
) -> tuple[Float32[Tensor, "1 N 3 H W"], Rig]:
    """What a network takes: all pictures at one even size, in [0, 1], and the rig at that size.

    Args:
        images: of every camera, of any size.
        rig: the cameras.
        width: about the width of the result, px, in the shape of the rig's first camera; None: that camera's own.

    Raises:
        UserError: when lenses forbid it, which have one focal length and cannot be stretched.
    """
    size = even_size(rig.cameras[0], rig.cameras[0].width if width is None else width)
    try:
        scaled_rig = rig.resized(*size)
    except ValueError as error:
        raise UserError(f"the rig's cameras cannot be brought to one size: {error}") from error
    batch = torch.from_numpy(np.stack([_scaled(image, size) for image in images]))
    return batch.permute(0, 3, 1, 2).unsqueeze(0).float() / 255, scaled_rig


def even_size(camera: Camera, width: int) -> tuple[int, int]:
    """Even width and height near a width, of exactly the camera's shape where there is such a size below it."""
    divisor = math.gcd(camera.width, camera.height)
    unit = camera.width // divisor, camera.height // divisor
    if unit[0] % 2 or unit[1] % 2:
        unit = 2 * unit[0], 2 * unit[1]
    if unit[0] <= width:
        return unit[0] * (width // unit[0]), unit[1] * (width // unit[0])
    return max(2, width // 2 * 2), max(2, 2 * round(width * camera.height / camera.width / 2))


def _scaled(image: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    smaller = size[0] < image.shape[1]
    return cv2.resize(image, size, interpolation=cv2.INTER_AREA if smaller else cv2.INTER_LINEAR)
