"""Image files of the cameras of a rig: find them, check them against the calibration, read and resize them."""

import math
import re
from collections.abc import Iterable, Iterator, Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from jaxtyping import Float32
from torch import Tensor

from omniocc.camera import Camera, Rig
from omniocc.camera.masks import lenses_that_do_not_fit
from omniocc.camera.plausible import wrong_road
from omniocc.camera.seams import better_order
from omniocc.data.formats.files import IMAGE_SUFFIXES, rgb_of_camera, scaled_to
from omniocc.errors import DataError, UserError
from omniocc.images import Depth, content_of
from omniocc.io import twice


class FrameFiles(NamedTuple):
    """One frame of a sequence.

    Attributes:
        name: name of its folder; empty for a single frame.
        files: image file of every camera; None for cameras that are left out.
        bit_depth: number of bits that samples of 16-bit images use.
    """

    name: str
    files: tuple[Path | None, ...]
    bit_depth: Depth = Depth(key="image_bits")


def find_frames(
    images: str | Sequence[str], rig: Rig, excluded: Sequence[str] = (), image_bits: int | None = None
) -> list[FrameFiles]:
    """Return the frames with the files of every camera of the rig, ordered by the numbers in their folders' names.

    Args:
        images: a folder with one image per camera, named as the camera; or a folder of such folders, one per frame;
            or a folder with one folder per camera, whose images are named as the frames; or one file per camera, in the
            rig's order, or in any where all are named as the cameras.
        rig: the cameras.
        excluded: names of the cameras to leave out; their files may be missing.
        image_bits: number of bits that samples of 16-bit images use; None: not known.

    Raises:
        UserError: naming the file or camera that is missing, superfluous or misspelt, or the impossible number of bits.
    """
    check_excluded(excluded, rig)
    bit_depth = Depth(image_bits, "image_bits")
    return [frame._replace(bit_depth=bit_depth) for frame in _match_frames(images, rig, excluded)]


def _match_frames(images: str | Sequence[str], rig: Rig, excluded: Sequence[str]) -> list[FrameFiles]:
    if not isinstance(images, str):
        return [_match_list([Path(path) for path in images], rig, excluded)]
    folder = Path(images)
    if not folder.is_dir():
        found = "this is one file; give its folder, or a list with one image per camera: images=[a.png,b.png]"
        raise UserError(f"images={images}: {found if folder.exists() else 'there is no such folder'}")
    folders = (path for path in folder.iterdir() if path.is_dir() and not path.name.startswith("."))
    frames = sorted((path for path in folders if _image_files(path)), key=natural_key)
    of_cameras = any(path.stem in rig.names for path in _image_files(folder))  # others may be masks of the rig
    if of_cameras and (own := [one for one in frames if any(path.stem in rig.names for path in _image_files(one))]):
        raise UserError(
            f"{folder} holds images that are named as cameras, and folders of such images ({own[0].name}): give one of "
            "them as images=..., or move the masks of the rig elsewhere"
        )
    if of_cameras or not frames:
        return [FrameFiles("", _match_folder(folder, rig, excluded))]
    if {path.name for path in frames} & set(rig.names):
        return _by_camera(folder, [path.name for path in frames], rig, excluded)
    return [FrameFiles(frame.name, _match_folder(frame, rig, excluded)) for frame in frames]


def _by_camera(folder: Path, folders: Sequence[str], rig: Rig, excluded: Sequence[str]) -> list[FrameFiles]:
    """Return the frames of a folder with a folder of images for each camera, as OmniMVS has them."""
    for name in rig.names:
        if name not in (*folders, *excluded):
            others = [other for other in folders if other not in rig.names]
            raise UserError(
                f"{folder}: no folder with images of camera '{name}'{suggest_name(name, others)}; "
                f"exclude_cameras=[{name}] leaves it out"
            )
    found = {name: _image_files(folder / name) for name in rig.names if name not in excluded}
    by_stem = {name: {path.stem: path for path in paths} for name, paths in found.items()}
    for name, paths in found.items():
        stems = [path.stem for path in paths]
        if stem := twice(stems):
            raise UserError(f"{folder / name}: several images of frame '{stem}'; keep one")
        if lacking := sorted({stem for other in by_stem.values() for stem in other} - set(stems)):
            raise UserError(f"{folder / name}: no image of frame '{lacking[0]}', which other cameras have")
    frames = sorted(next(iter(found.values())), key=natural_key)
    return [
        FrameFiles(path.stem, tuple(by_stem[name][path.stem] if name in found else None for name in rig.names))
        for path in frames
    ]


def names_of(cameras: Any) -> list[str]:
    """Return the names of cameras that an option states: one, a list, or None; a name may look like a number."""
    if cameras is None:
        return []
    return list(map(str, cameras)) if isinstance(cameras, Sequence) and not isinstance(cameras, str) else [str(cameras)]


def check_excluded(excluded: Sequence[str], rig: Rig) -> None:
    """Check that the names are cameras of the rig, and not all of them.

    Raises:
        UserError: naming the unknown camera and those of the rig; or if every camera is excluded.
    """
    for name in excluded:
        if name not in rig.names:
            hint = suggest_name(name, rig.names)
            raise UserError(f"exclude_cameras={name}: no such camera{hint}; cameras: {', '.join(rig.names)}")
    if len(set(excluded)) == len(rig.names):
        raise UserError("every camera is excluded; keep at least one")


def natural_key(path: Path) -> list[tuple[int, str]]:
    """Return the sorting key that orders names by the numbers in them: 9 before 10."""
    return [(int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", path.name)]


def _match_list(paths: list[Path], rig: Rig, excluded: Sequence[str]) -> FrameFiles:
    if len(paths) != len(rig.names):
        names = ", ".join(rig.names)
        raise UserError(f"{len(paths)} images for {len(rig.names)} cameras; give one each, in this order: {names}")
    named = {path.stem: path for path in paths}
    paths = [named[name] for name in rig.names] if set(named) == set(rig.names) else paths
    for path, name in zip(paths, rig.names, strict=True):
        if not path.is_file() and name not in excluded:
            raise UserError(f"there is no image {path} (camera '{name}')")
    return FrameFiles(
        "", tuple(None if name in excluded else path for path, name in zip(paths, rig.names, strict=True))
    )


def _match_folder(folder: Path, rig: Rig, excluded: Sequence[str]) -> tuple[Path | None, ...]:
    return tuple(None if name in excluded else _image_of(name, folder, rig) for name in rig.names)


def _image_of(name: str, folder: Path, rig: Rig) -> Path:
    images = _image_files(folder)
    matches = [path for path in images if path.stem == name]
    if len(matches) == 1:
        return matches[0]
    if matches:
        names = ", ".join(path.name for path in matches)
        raise UserError(f"{folder}: several images of camera '{name}': {names}; keep one")
    others = [path.stem for path in images if path.stem not in rig.names]
    others_text = f"; images that belong to no camera of the rig: {', '.join(sorted(others)[:8])}" if others else ""
    raise UserError(
        f"{folder}: no image of camera '{name}' (a file {name}.png or {name}.jpg)"
        f"{suggest_name(name, others)}{others_text}; exclude_cameras=[{name}] leaves it out"
    )


def suggest_name(name: str, others: Iterable[str]) -> str:
    """Return the question " (is it '<other>'?)" with the most similar other name; empty if none is similar."""
    close = get_close_matches(name, list(others), n=1)
    return f" (is it '{close[0]}'?)" if close else ""


def _image_files(folder: Path) -> list[Path]:
    return sorted(path for path in folder.iterdir() if path.is_file() and path.suffix.lower() in IMAGE_SUFFIXES)


def remarks(frames: Sequence[FrameFiles], rig: Rig) -> Iterator[str]:
    """Yield lines about what may be wrong, beside the names of listed images.

    These are images that are not used, lens models that do not fit, a height of the road that cannot be, and images of
    the first frame that fit better in another order.

    Raises:
        UserError: naming an image of the first frame that cannot be read.
    """
    files = dict(zip(rig.names, frames[0].files, strict=True))
    listed = frames[0].name == ""
    if listed and not {file.stem for file in files.values() if file is not None} <= set(rig.names):
        yield "images    " + ", ".join(f"{name}={file.name}" for name, file in files.items() if file is not None)
    if line := describe_ignored_images(frames, rig):
        yield line
    yield from lenses_that_do_not_fit(rig)
    yield from (f"road      {line}" for line in wrong_road(rig))
    if line := swapped_images(frames[0], rig):
        yield line


def swapped_images(frame: FrameFiles, rig: Rig) -> str:
    """Return a line with the order in which the images of a frame fit better, or nothing; see `better_order`."""
    return "" if None in frame.files else order_line(read_frame(frame, rig), rig, frame.files)


def order_line(images: Sequence[np.ndarray], rig: Rig, sources: Sequence[object]) -> str:
    """Return a line with the order in which the images of a frame fit better, by their sources; empty if they fit."""
    if (order := better_order(images, rig)) is None:
        return ""
    moved = [
        f"{name}={sources[image]}" for k, (name, image) in enumerate(zip(rig.names, order, strict=True)) if k != image
    ]
    return f"images    where two cameras see the same, the images fit better as {', '.join(moved)}; are they swapped?"


def describe_ignored_images(frames: Sequence[FrameFiles], rig: Rig) -> str:
    """Return a line on the images in the first frame's folder that belong to no camera; empty if all do."""
    files = {file.stem: file for file in frames[0].files if file is not None}
    if not set(files) <= set(rig.names):  # files of a list, which may have any names
        return ""
    folder = next(iter(files.values())).parent
    others = [file.name for file in _image_files(folder) if file.stem not in rig.names]
    return f"{folder}: not used, no camera of the rig has this name: {', '.join(others[:8])}" if others else ""


def read_frame(frame: FrameFiles, rig: Rig) -> list[np.ndarray]:
    """Return (H, W, 3) uint8 RGB of every camera, at the size of its file.

    Cameras that are left out give a black image at the size of the calibration.

    Raises:
        UserError: naming the file that cannot be read or has another aspect ratio than its camera's calibration.
    """
    return [_read_image(file, rig, camera, frame.bit_depth) for camera, file in enumerate(frame.files)]


def _read_image(file: Path | None, rig: Rig, index: int, bit_depth: Depth) -> np.ndarray:
    camera, name = rig.cameras[index], rig.names[index]
    if file is None:
        return np.zeros((camera.height, camera.width, 3), np.uint8)
    try:
        return rgb_of_camera(content_of(file), str(file), camera, bit_depth, f"camera '{name}'")
    except DataError as error:
        raise UserError(f"{error}; exclude_cameras=[{name}] leaves the camera out") from error


def resized_to_width(
    images: Sequence[np.ndarray], rig: Rig, width: int | None
) -> tuple[Float32[Tensor, "1 N 3 H W"], Rig]:
    """Return the input of a network: all images at one size, in [0, 1], and the rig at that size.

    Args:
        images: of every camera, of any size.
        rig: the cameras.
        width: approximate width of the result, px; None: the first camera's width. `even_size` makes it even and gives
            the height, by the first camera's aspect ratio.

    Raises:
        UserError: when the width is no whole number of px, or too small for an image.
    """
    check_width(width)
    size = even_size(rig.cameras[0], rig.cameras[0].width if width is None else width)
    scaled_rig = rig.resized(*size)
    batch = torch.from_numpy(np.stack([scaled_to(image, size) for image in images]))
    return batch.permute(0, 3, 1, 2).unsqueeze(0).float() / 255, scaled_rig


def check_width(width: Any) -> None:
    """Raise UserError for a width that is no whole number of px, or too small for an image; None is none."""
    if width is not None and (isinstance(width, bool) or not isinstance(width, int) or width < LEAST_PX):
        raise UserError(f"image_width={width}: give a whole number of px, {LEAST_PX} or more")


LEAST_PX = 16
LEAST_WIDTH = 0.9
"""Smallest fraction of the wanted width at which the exact aspect ratio is kept; below it the ratio is rounded."""


def even_size(camera: Camera, width: int) -> tuple[int, int]:
    """Return an even width near `width` and an even height, px.

    They have exactly the camera's aspect ratio where such a size is at most a tenth narrower than `width`.
    """
    divisor = math.gcd(camera.width, camera.height)
    smallest = camera.width // divisor, camera.height // divisor
    if smallest[0] % 2 or smallest[1] % 2:
        smallest = 2 * smallest[0], 2 * smallest[1]
    times = width // smallest[0]
    if smallest[0] * times >= LEAST_WIDTH * width:
        return smallest[0] * times, smallest[1] * times
    return max(2, width // 2 * 2), max(2, 2 * round(width * camera.height / camera.width / 2))
