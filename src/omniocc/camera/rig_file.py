"""Rig files: one YAML per rig.

    road_z_m: -2.2                            # optional, m, height of the road in the rig's frame
    cameras:
      front:
        model: equidistant                    # a key of MODELS below
        width: 512                            # then the parameters of the model, by name
        height: 288
        focal_px: 154.4
        center_px: [255.5, 143.5]
        max_angle_deg: 95.0
        ego_from_camera: {position_m: [0.9, 0, 0], yaw_deg: 0, pitch_deg: -10, roll_deg: 0}
        mask: front.png                       # optional, relative to this file; not 0 where the image is usable
      rear:
        calibration: rear_opencv.yaml         # or, in place of model and parameters, a calibration file of one camera
        ego_from_camera: {position_m: [-0.9, 0, 0], yaw_deg: 180, pitch_deg: -10, roll_deg: 0}

Angles are those of `omniocc.camera.pose.pose_from_angles`. `ego_from_camera` may also be the four rows of a 4x4 matrix.
`write_rig` writes those, as angles would not reproduce a calibrated pose to the last bit.
"""

import dataclasses
import difflib
import re
from collections.abc import Sequence
from os import PathLike
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
import yaml
from jaxtyping import Bool, Float64
from torch import Tensor

from omniocc.camera.calibration import Calibration, parse, read_calibration, read_calibration_folder
from omniocc.camera.calibration.fields import mapping, naming, read_mask_of
from omniocc.camera.models.double_sphere import DoubleSphere
from omniocc.camera.models.equidistant import Equidistant
from omniocc.camera.models.eucm import EUCM
from omniocc.camera.models.kannala_brandt import KannalaBrandt
from omniocc.camera.models.mei import MEI
from omniocc.camera.models.ocam import OCam
from omniocc.camera.models.panoramic import Panoramic
from omniocc.camera.models.pinhole import Pinhole
from omniocc.camera.models.radial_polynomial import RadialPolynomial
from omniocc.camera.pose import check_rigid, pose_from_angles
from omniocc.camera.protocol import Camera, finite, numbers
from omniocc.errors import repr_of
from omniocc.io import atomic_write, checked_name, read_short_text

MODELS = {
    "equidistant": Equidistant,
    "pinhole": Pinhole,
    "kannala_brandt": KannalaBrandt,
    "mei": MEI,
    "ocam": OCam,
    "double_sphere": DoubleSphere,
    "eucm": EUCM,
    "radial_polynomial": RadialPolynomial,
    "panoramic": Panoramic,
}
BUILT_IN = Path(__file__).parent / "rigs"
MAX_CAMERAS = 100
ANGLES = ("yaw_deg", "pitch_deg", "roll_deg")

Mask = Bool[Tensor, "_ _"]


def read_rig(path: str | PathLike[str], within: Sequence[Path] = ()) -> Calibration:
    """Return the arguments of `Rig`; `within` are the rig files that name this one as a calibration.

    Raises:
        ValueError: naming the file, the camera and the wrong value.
    """
    file: Path | Calibration = _find(path)
    if file.is_dir():
        file = read_calibration_folder(file)
    if isinstance(file, Calibration):
        return file
    with naming(str(file)):
        text = read_short_text(file)
        content = parse(text)
        if not isinstance(content, dict) or isinstance(content.get("cameras", []), list):
            return read_calibration(file, text, content)
        _check_keys(content, ["cameras"], ["road_z_m"])
        road_z_m = None if content.get("road_z_m") is None else finite("road_z_m", content["road_z_m"])
        entries = mapping(content["cameras"], "'cameras'")
        if len(entries) > MAX_CAMERAS:
            raise ValueError(f"'cameras' has {len(entries):,} entries; at most {MAX_CAMERAS} are read")
        for name in entries:  # YAML reads 007 as 7 and on as True
            if not isinstance(name, str) and not re.search(rf"(?<![\w.+-]){name}\s*:", text):
                raise ValueError(f"the name of a camera reads as {name!r}; write it in quotes")
        names = tuple(checked_name("the name of a camera", str(name)) for name in entries)
    read = [_read_entry([*within, file], name, entry) for name, entry in zip(names, entries.values(), strict=True)]
    cameras, poses, masks = zip(*read, strict=True)
    known = None if all(mask is None for mask in masks) else masks
    return Calibration(cameras, torch.stack(poses), names, known, road_z_m)


def write_rig(path: str | PathLike[str], rig: Calibration) -> None:
    """Write a rig file; see `Rig.save`; raise DataError naming the file that cannot be written."""
    file = Path(path)
    model_names = {model: name for name, model in MODELS.items()}
    entries = {}
    for index, (name, camera) in enumerate(zip(rig.names, rig.cameras, strict=True)):
        parameters = {key: list(v) if isinstance(v, tuple) else v for key, v in vars(camera).items()}
        entry = {
            "model": model_names[type(camera)],
            **parameters,
            "ego_from_camera": rig.ego_from_camera[index].tolist(),
        }
        mask = None if rig.masks is None else rig.masks[index]
        if mask is not None:
            entry["mask"] = f"{file.stem}.{name}.png"
            _, png = cv2.imencode(".png", mask.numpy().astype(np.uint8) * 255)
            atomic_write(file.parent / entry["mask"], png.tobytes())
        entries[name] = entry
    road = {} if rig.road_z_m is None else {"road_z_m": rig.road_z_m}
    atomic_write(file, yaml.safe_dump(road | {"cameras": entries}, sort_keys=False, default_flow_style=None))


def _read_entry(files: Sequence[Path], name: str, entry: Any) -> tuple[Camera, Float64[Tensor, "4 4"], Mask | None]:
    file = files[-1]
    with naming(f"{file}: camera '{name}'"):
        camera = _read_camera(files, mapping(entry, "its entry"))
        pose = _read_pose(entry["ego_from_camera"])
        if "mask" not in entry:
            return camera, pose, None
        return camera, pose, read_mask_of("mask", file.parent / str(entry["mask"]), camera)


def _find(path: str | PathLike[str]) -> Path:
    built_in = {file.stem: file for file in sorted(BUILT_IN.glob("*.yaml"))}
    if str(path) in built_in:
        return built_in[str(path)]
    if not Path(path).exists():
        hint = _did_you_mean(str(path), list(built_in))
        raise ValueError(f"no rig file '{path}'{hint}; built-in rigs: {', '.join(built_in)}")
    return Path(path)


def _read_camera(files: Sequence[Path], entry: dict[str, Any]) -> Camera:
    if "calibration" in entry:
        _check_keys(entry, ["calibration", "ego_from_camera"], ["mask"])
        file = files[-1].parent / str(entry["calibration"])
        if not file.is_file() and not file.is_dir():
            raise ValueError(f"calibration {file} does not exist, or is a device or pipe")
        if file.resolve() in [other.resolve() for other in files]:
            raise ValueError(f"calibration {file} leads back to itself; name a file with lens and size of the image")
        cameras = read_rig(file, files).cameras
        if len(cameras) != 1:
            raise ValueError(f"calibration {entry['calibration']} holds {len(cameras)} cameras; it must be one")
        return cameras[0]
    if "model" not in entry:
        raise ValueError(f"it has neither a model ({', '.join(MODELS)}) nor a calibration, the file of another tool")
    name = entry["model"]
    if not isinstance(name, str) or name not in MODELS:
        raise ValueError(f"unknown model '{name}'{_did_you_mean(str(name), list(MODELS))}; models: {', '.join(MODELS)}")
    model = MODELS[name]
    parameters = [field.name for field in dataclasses.fields(model)]
    _check_keys(entry, ["model", *parameters, "ego_from_camera"], ["mask"])
    return model(**{key: _parameter(key, entry[key]) for key in parameters})


def _parameter(key: str, value: Any) -> Any:
    if key in ("width", "height"):
        return value
    return tuple(finite(key, number) for number in value) if isinstance(value, list) else finite(key, value)


def _read_pose(value: Any) -> Float64[Tensor, "4 4"]:
    if isinstance(value, dict):
        _check_keys(value, ["position_m", *ANGLES], [], "ego_from_camera.")
        x, y, z = numbers("ego_from_camera.position_m", value["position_m"], 3, 3)
        yaw, pitch, roll = (finite(f"ego_from_camera.{key}", value[key]) for key in ANGLES)
        return pose_from_angles((x, y, z), yaw, pitch, roll)
    if not isinstance(value, list) or len(value) != 4:
        raise ValueError(
            f"ego_from_camera is {repr_of(value)}; give position_m, {', '.join(ANGLES)}, or four rows of 4 numbers"
        )
    rows = [numbers("a row of ego_from_camera", row, 4, 4) for row in value]
    pose = torch.tensor(rows, dtype=torch.float64)
    check_rigid(pose, "its pose")
    return pose


def _check_keys(entry: dict[str, Any], required: list[str], optional: list[str], prefix: str = "") -> None:
    for key in required:
        if key not in entry:
            raise ValueError(f"{prefix}{key} is missing")
    known = required + optional
    for key in entry:
        if key not in known:
            raise ValueError(f"unknown key {prefix}{key}{_did_you_mean(str(key), known)}; keys: {', '.join(known)}")


def _did_you_mean(word: str, choices: list[str]) -> str:
    close = difflib.get_close_matches(word, choices, n=1)
    return f"; did you mean '{close[0]}'?" if close else ""
