"""Readers of NVIDIA's f-theta calibrations: one camera of NCore, and the rig file of DriveWorks."""

import math
from typing import Any

import torch
from jaxtyping import Float64
from torch import Tensor

from omniocc.camera.calibration.fields import (
    Calibration,
    centered,
    mapping,
    naming,
    number,
    required,
    row,
    single,
    size,
)
from omniocc.camera.models.ftheta import FTheta
from omniocc.camera.pose import LEVEL_FORWARD, pose_from_angles, rigid_pose

REFERENCES = {"ANGLE_TO_PIXELDIST": "angle_to_pixeldist", "PIXELDIST_TO_ANGLE": "pixeldist_to_angle"}
TYPES = {"angle-to-pixeldistance": "angle_to_pixeldist", "pixeldistance-to-angle": "pixeldist_to_angle"}
ANGLES, TURN, SHIFT = "roll-pitch-yaw", "correction_sensor_R_FLU", "correction_rig_T"


def read_ncore(content: dict[str, Any], name: str) -> Calibration:
    """Return one camera from the JSON of NCore's `FThetaCameraModelParameters`; only its reference polynomial is used.

    Raises:
        ValueError: naming the key that is missing or wrong, or the distortion by a windshield, which no model has.
    """
    if content.get("external_distortion_parameters") is not None:
        raise ValueError("external_distortion_parameters: a windshield is not supported; it must be null")
    reference = _chosen("reference_poly", content["reference_poly"], REFERENCES)
    width, height = size(content, "resolution")
    cx, cy = row(content, 2, "principal_point")
    linear = row({"linear_cde": [1, 0, 0]} | content, 3, "linear_cde")
    polynomial = row(content, None, f"{reference}_poly")
    return single(_camera(width, height, (cx, cy), reference, polynomial, linear, number(content, "max_angle")), name)


def read_driveworks(content: dict[str, Any]) -> Calibration:
    """Return the cameras of `rig: sensors:` with their poses, with corrections; their masks (`car-mask`) are not read.

    The file's frame (x forward, y left, z up) has its origin on the road below the rear axle. That of the ego frame is
    the mean position of the cameras, so the height of the road is known.

    Raises:
        ValueError: naming the sensor and the key that is missing or wrong.
    """
    sensors = required(mapping(content["rig"], "rig"), "sensors")
    if not isinstance(sensors, list):
        raise ValueError("rig.sensors must be a list of sensors")
    cameras, poses, names = [], [], []
    for index, sensor in enumerate(sensors):
        name = str(mapping(sensor, f"sensors[{index}]").get("name", index))
        if not str(sensor.get("protocol", name)).startswith("camera"):
            continue
        with naming(name):
            cameras.append(_driveworks_camera(mapping(required(sensor, "properties"), "properties")))
            poses.append(_rig_from_camera(sensor))
        names.append(name.replace(":", "_"))  # no file could be called by it
    if not cameras:
        raise ValueError("rig.sensors holds no camera, whose protocol or name begins with 'camera'")
    rig_from_camera = torch.stack(poses)
    road_z_m = -float(rig_from_camera[:, 2, 3].mean())
    return Calibration(tuple(cameras), centered(rig_from_camera), tuple(names), None, road_z_m)


def _driveworks_camera(properties: dict[str, Any]) -> FTheta:
    if (model := required(properties, "Model")) != "ftheta":
        raise ValueError(f"Model is {model!r}; of DriveWorks' models only ftheta is read")
    key = "polynomial" if "polynomial" in properties else "bw-poly"
    kind = required(properties, "polynomial-type") if key == "polynomial" else "pixeldistance-to-angle"
    reference = _chosen("polynomial-type", kind, TYPES)
    polynomial = row({key: str(required(properties, key)).split()}, None, key)
    shear = {"linear-c": 1, "linear-d": 0, "linear-e": 0} | properties
    linear = [number(shear, f"linear-{letter}") for letter in "cde"]
    width, height = size(
        {"width, height": [required(properties, "width"), required(properties, "height")]}, "width, height"
    )
    return _camera(
        width, height, (number(properties, "cx"), number(properties, "cy")), reference, polynomial, linear, math.pi
    )


def _camera(
    width: int,
    height: int,
    center_px: tuple[float, float],
    reference: str,
    polynomial: list[float],
    linear: list[float],
    max_rad: float,
) -> FTheta:
    polynomials = {"angle_to_pixeldist": (), "pixeldist_to_angle": (), reference: tuple(polynomial)}
    linear_cde = tuple(linear) if any(linear) else (1.0, 0.0, 0.0)  # all zero says 'none', by NVIDIA's reference
    return FTheta(width, height, center_px, **polynomials, linear_cde=linear_cde, max_angle_deg=math.degrees(max_rad))


def _rig_from_camera(sensor: dict[str, Any]) -> Float64[Tensor, "4 4"]:
    """Return the pose of a sensor whose nominal angles and position are corrected in its own and in the rig's frame."""
    nominal = mapping(required(sensor, "nominalSensor2Rig_FLU"), "nominalSensor2Rig_FLU")
    correction = mapping(sensor.get(TURN, {ANGLES: [0, 0, 0]}), TURN)
    position = torch.tensor(row(nominal, 3, "t"), dtype=torch.float64)
    shift = torch.tensor(row({SHIFT: [0, 0, 0]} | sensor, 3, SHIFT), dtype=torch.float64)
    rotation = _turn(nominal) @ _turn(correction) @ torch.tensor(LEVEL_FORWARD, dtype=torch.float64)
    return rigid_pose(rotation, position + shift)


def _turn(entry: dict[str, Any]) -> Float64[Tensor, "3 3"]:
    """Return the rotation by roll, then pitch (downwards), then yaw, deg, about axes x forward, y left, z up."""
    roll, pitch, yaw = row(entry, 3, ANGLES)
    camera = pose_from_angles((0.0, 0.0, 0.0), yaw, -pitch, roll)[:3, :3]
    return camera @ torch.tensor(LEVEL_FORWARD, dtype=torch.float64).T


def _chosen(key: str, value: Any, choices: dict[str, str]) -> str:
    if not isinstance(value, str) or value not in choices:
        raise ValueError(f"{key} is {value!r}; it must be one of {', '.join(choices)}")
    return choices[value]
