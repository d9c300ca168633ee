"""Read the text file of OCamCalib (`calib_results.txt`)."""

from omniocc.camera.calibration.fields import Calibration, number, single
from omniocc.camera.models.ocam import OCam

LINE_NAMES = ("polynomial", "inverse polynomial", "centre (row, column)", "affine parameters (c, d, e)", "image size")
"""Lines of numbers in the order of the file."""


def is_ocamcalib(text: str) -> bool:
    """Return whether a text begins with OCamCalib's first comment, or holds nothing but numbers and comments."""
    lines = _split_lines(text)
    only_numbers = bool(lines) and all(word[0] in "+-.0123456789" for line in lines for word in line)
    return only_numbers or text.replace(" ", "").lstrip().startswith("#polynomialcoefficients")


def read_ocamcalib(text: str, name: str) -> Calibration:
    """Return the one camera of a text of five lines of numbers (`LINE_NAMES`) between comments.

    Each polynomial begins with the count of its coefficients.

    Raises:
        ValueError: naming the line that is missing or wrong.
    """
    lines = _split_lines(text)
    if len(lines) != len(LINE_NAMES):
        raise ValueError(f"{len(lines)} lines of numbers; OCamCalib writes {len(LINE_NAMES)}: {', '.join(LINE_NAMES)}")
    polynomial = drop_count(LINE_NAMES[0], _parse_numbers(LINE_NAMES[0], lines[0]))
    inverse = drop_count(LINE_NAMES[1], _parse_numbers(LINE_NAMES[1], lines[1]))
    center = _parse_numbers(LINE_NAMES[2], lines[2], 2)
    affine = _parse_numbers(LINE_NAMES[3], lines[3], 3)
    height, width = _parse_numbers(LINE_NAMES[4], lines[4], 2)
    if not (height.is_integer() and width.is_integer()):
        raise ValueError(f"{LINE_NAMES[4]} is '{' '.join(lines[4])}'; it must be whole numbers of pixels")
    center_px = (center[1], center[0])  # (column, row)
    # The file states no largest angle: at 180 degrees the polynomials alone limit it.
    camera = OCam(int(width), int(height), center_px, polynomial, inverse, tuple(affine), max_angle_deg=180.0)
    return single(camera, name)


def drop_count(name: str, values: list[float]) -> tuple[float, ...]:
    """Return the coefficients that follow their count; raise ValueError if the count is wrong."""
    if not values or values[0] != len(values) - 1:
        count = f"{values[0]:g}" if values else "nothing"
        raise ValueError(f"{name} announces {count} coefficients and holds {len(values) - 1}; is the file whole?")
    return tuple(values[1:])


def _split_lines(text: str) -> list[list[str]]:
    """Return the words of every line that has any beside its comment."""
    lines = [line.split("#")[0].split() for line in text.splitlines()]
    return [line for line in lines if line]


def _parse_numbers(name: str, words: list[str], count: int | None = None) -> list[float]:
    if count is not None and len(words) != count:
        raise ValueError(f"{name} is '{' '.join(words)}'; it must be {count} numbers; is the file whole?")
    return [number({name: word}, name) for word in words]
