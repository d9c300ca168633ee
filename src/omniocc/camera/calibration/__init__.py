"""Readers of the calibration files of other tools, recognised by their content."""

from pathlib import Path
from typing import Any

from omniocc.camera.calibration.fields import Calibration
from omniocc.camera.calibration.kitti360 import POSES, read_kitti360, read_kitti360_folder
from omniocc.camera.calibration.nvidia import read_driveworks, read_ncore
from omniocc.camera.calibration.ocamcalib import is_ocamcalib, read_ocamcalib
from omniocc.camera.calibration.yaml_files import read_kalibr, read_omnimvs, read_opencv
from omniocc.io import parse_yaml

__all__ = ["Calibration", "parse", "read_calibration", "read_calibration_folder"]

FORMATS = (
    "a rig file ('cameras' is a mapping), OmniMVS ('cameras' is a list), Kalibr camchain ('cam0'), "
    "OpenCV ('camera_matrix'), KITTI-360 ('model_type: MEI'), NCore ('reference_poly'), DriveWorks ('rig'), "
    "OCamCalib (lines of numbers)"
)


def parse(text: str) -> Any:
    """Return the content of a YAML text, or None for an OCamCalib text; raise ValueError if it is broken."""
    return None if is_ocamcalib(text) else parse_yaml(text)


def read_calibration(file: Path, text: str, content: Any) -> Calibration:
    """Return the cameras of a calibration file, given its text and the content from `parse`.

    A file with one camera and no pose gives a rig whose forward direction is that of the camera.

    Raises:
        ValueError: naming the key that is missing or wrong, or the known formats; the caller adds the file.
    """
    if is_ocamcalib(text):
        return read_ocamcalib(text, file.stem)
    if isinstance(content, dict):
        if isinstance(content.get("cameras"), list):
            return read_omnimvs(content, file.parent)
        if "model_type" in content:
            return read_kitti360(content, file.stem)
        if "reference_poly" in content:
            return read_ncore(content, file.stem)
        if "rig" in content:
            return read_driveworks(content)
        if "camera_matrix" in content:
            return read_opencv(content, file.stem)
        if any(isinstance(entry, dict) and "camera_model" in entry for entry in content.values()):
            return read_kalibr(content)
    raise ValueError(f"unknown calibration format; known are: {FORMATS}")


def read_calibration_folder(folder: Path) -> Calibration | Path:
    """Return the calibration in a KITTI-360 folder, or the path of the `rig.yaml` or `config.yaml` (OmniMVS) in it.

    Raises:
        ValueError: if the folder holds none of them.
    """
    if (folder / POSES).is_file():
        return read_kitti360_folder(folder)
    for name in ("rig.yaml", "config.yaml"):
        if (folder / name).is_file():
            return folder / name
    raise ValueError(f"{folder}: none of {POSES}, rig.yaml, config.yaml is in this folder; name the calibration file")
