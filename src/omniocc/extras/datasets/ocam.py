"""Lenses of public datasets that come as files of OCamCalib."""

from dataclasses import replace
from pathlib import Path

from omniocc.camera import OCam
from omniocc.camera.calibration.ocamcalib import read_ocamcalib
from omniocc.data.formats.files import read_text
from omniocc.errors import DataError


def read_ocam(path: Path, size: tuple[int, int] | None, max_angle_deg: float) -> OCam:
    """Return the lens of a file.

    Args:
        path: the file.
        size: (width, height), px, that it must have; None: any.
        max_angle_deg: angle off the optical axis at which the image ends, which such files do not state.

    Raises:
        DataError: naming the file and what is wrong with it.
    """
    try:
        camera = read_ocamcalib(read_text(path), path.stem).cameras[0]
    except ValueError as error:
        raise DataError(f"{path}: {error}") from error
    assert isinstance(camera, OCam)
    if size is not None and (camera.width, camera.height) != size:
        raise DataError(f"{path}: the size is {camera.width}x{camera.height} px instead of {size[0]}x{size[1]} px")
    return replace(camera, max_angle_deg=max_angle_deg)
