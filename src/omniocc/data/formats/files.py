"""Read files of public datasets; every error names the file and what is wrong with it."""

import io
from collections.abc import Iterable, Sequence
from pathlib import Path

import cv2
import numpy as np

from omniocc.camera import Camera
from omniocc.data.formats.arrays import npy_array, npz_arrays
from omniocc.errors import DataError, first_line, in_line
from omniocc.images import Depth, content_of, decoded, rgb_of, size_of
from omniocc.io import read_bytes, text_of, twice
from rayiou.labels import MOST_SHOWN

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp", ".ppm")
SHAPE_TOLERANCE = 0.01
"""Largest relative difference between the aspect ratio of an image and that of its calibration: sizes are rounded."""
HEIGHT_STEP = 8
"""Heights of scaled images are multiples of it, px."""
LARGEST_WHOLE = 2.0**53
"""From here on float64 holds no fractions, and does not tell neighbouring whole numbers apart."""

# Paths are built from tables and opened as they are, as a folder may hold a million files. Only `check_root` lists one,
# for its message.


def read_text(path: Path, remedy: str = "") -> str:
    """Return the content of a text file, without byte-order mark; raise DataError if it is missing or no text."""
    try:
        return text_of(read_bytes(path, remedy))
    except ValueError as error:
        raise DataError(f"{path}: the file is damaged: {error}") from error


def read_array(path: Path, dtype: str, shape: Sequence[int], remedy: str = "") -> np.ndarray:
    """Return the numbers of a file without header as a writable array.

    Args:
        path: the file.
        dtype: of the numbers, with their byte order, such as '<f4'.
        shape: of the result; -1 in the first place takes as many rows as there are.
        remedy: what to do when the file is missing.

    Raises:
        DataError: if the file is missing or of another size.
    """
    content = read_bytes(path, remedy)
    row = int(np.prod(shape[1:], dtype=np.int64)) * np.dtype(dtype).itemsize
    expected = f"a multiple of {row:,}" if shape[0] < 0 else f"{row * shape[0]:,}"
    if len(content) % row if shape[0] < 0 else len(content) != row * shape[0]:
        raise DataError(f"{path}: the file has {len(content):,} bytes instead of {expected}; it is damaged")
    return np.frombuffer(bytearray(content), dtype).reshape(shape)


def read_npz(path: Path, shapes: dict[str, tuple[int, ...]], remedy: str = "") -> dict[str, np.ndarray]:
    """Return arrays of an npz file by name; raise DataError if one is missing, damaged or of another shape."""
    found = load_npz(path, shapes, remedy)
    for name, shape in shapes.items():
        if name not in found:
            raise DataError(f"{path}: the file has no array '{name}'")
        if found[name].shape != shape:
            raise DataError(f"{path}: its array '{name}' has the shape {found[name].shape} instead of {shape}")
    return found


def load_npz(path: Path, names: Iterable[str] | None = None, remedy: str = "") -> dict[str, np.ndarray]:
    """Return arrays of an npz file as `npz_arrays`; raise DataError if it is missing or damaged."""
    content = io.BytesIO(read_bytes(path, remedy))
    try:
        return npz_arrays(content, names)
    except Exception as error:  # zipfile, zlib and numpy have errors of their own
        raise DataError(f"{path}: the file is damaged ({first_line(error)})") from error


def named_once(names: Sequence[str], where: str) -> None:
    """Raise DataError beginning with `where` if a name of fields, properties or arrays stands twice."""
    if (name := twice(names)) is not None:
        raise DataError(f"{where} '{in_line(name)}' stands twice, so which of them is meant is unclear; rename one")


def read_npy(path: Path, shape: Sequence[int], remedy: str = "") -> np.ndarray:
    """Return the whole numbers of an npy file as int64, of whatever type they are stored.

    Args:
        path: the file.
        shape: of the result; -1 stands for any length.
        remedy: what to do when the file is missing.

    Raises:
        DataError: if the file is missing, damaged, of another shape, or holds other numbers.
    """
    numbers = load_npy(path, remedy)
    wanted = tuple(shape)
    fits = numbers.ndim == len(wanted) and all(
        want in (-1, have) for want, have in zip(wanted, numbers.shape, strict=True)
    )
    if not fits:
        raise DataError(f"{path}: the array has the shape {numbers.shape} instead of {wanted}")
    return whole_numbers(numbers, str(path))


def whole_numbers(numbers: np.ndarray, where: str) -> np.ndarray:
    """Return numbers of whatever type as int64; a fraction, nan or inf is never a label, nor a place of a cell.

    Raises:
        DataError: beginning with `where`, naming the first values that are no whole numbers.
    """
    kind = numbers.dtype.kind
    if kind == "f":
        wrong = numbers[~((numbers == np.round(numbers)) & (np.abs(numbers) < LARGEST_WHOLE))]
    else:
        wrong = numbers[:0] if kind in "biu" else numbers
    if wrong.size:
        found = ", ".join(map(str, dict.fromkeys(wrong.reshape(-1)[:MOST_SHOWN].tolist())))
        raise DataError(f"{where}: the array of {numbers.dtype} holds values that are no whole numbers: {found}")
    return numbers.astype(np.int64)


def load_npy(path: Path, remedy: str = "") -> np.ndarray:
    """Return the array of an npy file; raise DataError if it is missing or damaged."""
    content = read_bytes(path, remedy)
    try:
        return npy_array(io.BytesIO(content), len(content))
    except Exception as error:  # numpy has errors of its own
        raise DataError(f"{path}: the file is damaged ({first_line(error)})") from error


def decode(path: Path, flags: int, remedy: str = "") -> np.ndarray:
    """Return an image file as OpenCV decodes it (flags: `cv2.IMREAD_...`); raise DataError if there is none."""
    return decoded(content_of(path, remedy), flags, str(path))


def scaled_to(image: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Return an image at a width and height, px; the image itself if it has them."""
    height, width = image.shape[:2]
    if (width, height) == size:
        return image
    return cv2.resize(image, size, interpolation=cv2.INTER_AREA if size[0] < width else cv2.INTER_LINEAR)


def rgb_of_camera(content: bytes, where: str, camera: Camera, depth: Depth, whose: str = "its camera") -> np.ndarray:
    """Return an encoded image of a camera, (H, W, 3) uint8 RGB; raise DataError as `rgb_of` and `check_aspect`."""
    return rgb_of(content, where, depth, lambda size: check_aspect(size, camera, where, whose))


def check_aspect(size: tuple[int, int], camera: Camera, where: str, whose: str = "its camera") -> None:
    """Check that an image of a width and height has the aspect ratio of its camera's calibration; `whose` names it.

    Raises:
        DataError: beginning with `where`; a part of an image needs a calibration of its own.
    """
    width, height = size
    if abs(width / height / (camera.width / camera.height) - 1) > SHAPE_TOLERANCE:
        raise DataError(
            f"{where}: the image is {width}x{height} px, but {whose} is calibrated for "
            f"{camera.width}x{camera.height} px: a scaled image can be used, a cropped one needs its own calibration"
        )


def image_size(path: Path) -> tuple[int, int]:
    """Return width and height of an image file, px, as its header states; raise DataError if there is none."""
    return size_of(content_of(path), str(path))


def read_image(path: Path, size: tuple[int, int] | None, scaled: tuple[int, int], remedy: str = "") -> np.ndarray:
    """Return an image (height, width, 3) uint8 RGB.

    Args:
        path: the file.
        size: (width, height), px, that the calibration is for; None: any of the aspect ratio of the result.
        scaled: (width, height) of the result, px.
        remedy: what to do when the file is missing.

    Raises:
        DataError: if the file is missing, no image, or of another size.
    """

    def fits(found: tuple[int, int]) -> None:
        check_size(path, found, size, scaled)

    return scaled_to(rgb_of(content_of(path, remedy), str(path), fits=fits), scaled)


def check_size(path: Path, found: tuple[int, int], size: tuple[int, int] | None, scaled: tuple[int, int]) -> None:
    """Raise DataError if (width, height) are not `size` or, without one, of another aspect ratio than `scaled`."""
    ratio = found[0] / found[1] / (scaled[0] / scaled[1])
    fits = found == size if size else abs(ratio - 1) <= SHAPE_TOLERANCE + HEIGHT_STEP / 2 / scaled[1]
    if not fits:
        found_px, wanted_px = ("x".join(map(str, one)) for one in (found, size or scaled))
        whole = "" if size else ", or a multiple"
        raise DataError(f"{path}: the image has {found_px} px, but its calibration is for {wanted_px} px{whole}")


def map_classes(ids: np.ndarray, table: np.ndarray, path: Path) -> np.ndarray:
    """Return classes (uint8) of the ids in a file, which may be of any type.

    Raises:
        DataError: naming ids that are no whole numbers, or that the table does not know (-1).
    """
    ids = ids if ids.dtype.kind in "iu" else whole_numbers(ids, str(path))
    classes = table[np.clip(ids, 0, len(table) - 1)]
    unknown = (classes < 0) | (ids < 0) | (ids >= len(table))
    if unknown.any():
        found, known = np.unique(ids[unknown])[:MOST_SHOWN].tolist(), np.flatnonzero(table >= 0).tolist()
        gaps = known[-1] - known[0] >= len(known)
        has = ", ".join(map(str, known)) if gaps else f"{known[0]} to {known[-1]}"
        raise DataError(f"{path}: the class ids {found} are not in the dataset's table, which has {has}")
    return classes.astype(np.uint8)


def class_table(known: dict[int, int]) -> np.ndarray:
    """Return classes by id, (largest id + 1,) int16, -1 for ids that are not known."""
    table = np.full(max(known) + 1, -1, dtype=np.int16)
    for raw, class_id in known.items():
        table[raw] = class_id
    return table


def scaled_size(width: int, height: int, scaled_width: int) -> tuple[int, int]:
    """Return width and height (px) of an image scaled to a width; the height is a multiple of 8."""
    return scaled_width, max(HEIGHT_STEP, round(height * scaled_width / width / HEIGHT_STEP) * HEIGHT_STEP)


def check_root(root: str, expected: Sequence[str], how: str, key: str = "data.source.root=") -> Path:
    """Return the root of a dataset as a path; `key` stands before it in the message.

    Raises:
        DataError: listing what was expected and what was found.
    """
    path = Path(root)
    missing = [name for name in expected if not (path / name).exists()]
    if missing:
        found = sorted(entry.name for entry in path.iterdir())[:12] if path.is_dir() else []
        content = f"it holds {', '.join(found) or 'nothing'}" if path.is_dir() else "it is no folder"
        raise DataError(f"{key}{root}: {', '.join(missing)} not found, {content}; {how}")
    return path
