"""Calibration files of other tools, recognised by their content."""

from pathlib import Path
from typing import Any

from omniocc.camera.calibration.fields import Calibration, parse_yaml
from omniocc.camera.calibration.kalibr import read_kalibr
from omniocc.camera.calibration.kitti360 import POSES, read_kitti360, read_kitti360_folder
from omniocc.camera.calibration.ocamcalib import is_ocamcalib, read_ocamcalib
from omniocc.camera.calibration.omnimvs import read_omnimvs
from omniocc.camera.calibration.opencv import read_opencv

__all__ = ["Calibration", "parse", "read_calibration", "read_calibration_folder"]

FORMATS = (
    "a rig file ('cameras' is a mapping), OmniMVS ('cameras' is a list), Kalibr camchain ('cam0'), "
    "OpenCV ('camera_matrix'), KITTI-360 ('model_type: MEI'), OCamCalib (lines of numbers)"
)


def parse(text: str) -> Any:
    """What YAML makes of a text; None for OCamCalib's, which is no YAML. Raises ValueError."""
    return None if is_ocamcalib(text) else parse_yaml(text)


def read_calibration(file: Path, text: str, content: Any) -> Calibration:
    """Cameras of a file that is no rig file, given its text and what `parse` made of it.

    A file with one camera and no pose gives a rig that looks where the camera looks.

    Raises:
        ValueError: naming the key that is missing or wrong, or the formats that are known; not yet the file.
    """
    if is_ocamcalib(text):
        return read_ocamcalib(text, file.stem)
    if isinstance(content, dict):
        if isinstance(content.get("cameras"), list):
            return read_omnimvs(content, file.parent)
        if "model_type" in content:
            return read_kitti360(content, file.stem)
        if "camera_matrix" in content:
            return read_opencv(content, file.stem)
        if any(isinstance(entry, dict) and "camera_model" in entry for entry in content.values()):
            return read_kalibr(content)
    raise ValueError(f"no calibration format that is known; these are: {FORMATS}")


def read_calibration_folder(folder: Path) -> Calibration | Path:
    """A folder stands for KITTI-360's calibration, or for the `config.yaml` (OmniMVS) or `rig.yaml` in it.

    Raises:
        ValueError: if it holds none of them.
    """
    if (folder / POSES).is_file():
        return read_kitti360_folder(folder)
    for name in ("rig.yaml", "config.yaml"):
        if (folder / name).is_file():
            return folder / name
    raise ValueError(f"{folder}: none of {POSES}, rig.yaml, config.yaml is in this folder; name the calibration file")
