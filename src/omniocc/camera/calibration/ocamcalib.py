"""Reader of OCamCalib's text file (`calib_results.txt`)."""

from omniocc.camera.calibration.fields import Calibration, number, single
from omniocc.camera.models.ocam import OCam

LINES = ("polynomial", "inverse polynomial", "centre (row, column)", "affine parameters (c, d, e)", "image size")


def is_ocamcalib(text: str) -> bool:
    """Return whether a text begins with OCamCalib's first comment, or has only comments and lines of numbers."""
    lines = _data(text)
    only_numbers = bool(lines) and all(word[0] in "+-.0123456789" for line in lines for word in line)
    return only_numbers or text.replace(" ", "").lstrip().startswith("#polynomialcoefficients")


def read_ocamcalib(text: str, name: str) -> Calibration:
    """Return one camera from five lines of numbers between comments (`LINES`); the first two begin with their length.

    Raises:
        ValueError: naming the line that is missing or wrong.
    """
    lines = _data(text)
    if len(lines) != len(LINES):
        raise ValueError(f"{len(lines)} lines of numbers; OCamCalib writes {len(LINES)}: {', '.join(LINES)}")
    polynomial = counted(LINES[0], _numbers(LINES[0], lines[0]))
    inverse = counted(LINES[1], _numbers(LINES[1], lines[1]))
    center = _numbers(LINES[2], lines[2], 2)
    affine = _numbers(LINES[3], lines[3], 3)
    height, width = _numbers(LINES[4], lines[4], 2)
    if not (height.is_integer() and width.is_integer()):
        raise ValueError(f"{LINES[4]} is '{' '.join(lines[4])}'; it must be whole numbers of pixels")
    center_px = (center[1], center[0])
    return single(
        OCam(int(width), int(height), center_px, polynomial, inverse, tuple(affine), max_angle_deg=180.0), name
    )


def counted(name: str, values: list[float]) -> tuple[float, ...]:
    """Return coefficients without the count that precedes them; raise ValueError if the count is wrong."""
    if not values or values[0] != len(values) - 1:
        count = f"{values[0]:g}" if values else "nothing"
        raise ValueError(f"{name} announces {count} coefficients and holds {len(values) - 1}; is the file whole?")
    return tuple(values[1:])


def _data(text: str) -> list[list[str]]:
    lines = [line.split("#")[0].split() for line in text.splitlines()]
    return [line for line in lines if line]


def _numbers(name: str, words: list[str], count: int | None = None) -> list[float]:
    if count is not None and len(words) != count:
        raise ValueError(f"{name} is '{' '.join(words)}'; it must be {count} numbers; is the file whole?")
    return [number({name: word}, name) for word in words]
