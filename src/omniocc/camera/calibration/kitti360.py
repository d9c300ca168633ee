"""Reader of KITTI-360's fisheye YAML (CamOdoCal's MEI) and of the poses in the same folder."""

from pathlib import Path
from typing import Any

import torch

from omniocc.camera.calibration.fields import (
    Calibration,
    centered,
    mapping,
    naming,
    number,
    pose,
    required,
    single,
    whole,
)
from omniocc.camera.models.mei import MEI
from omniocc.io import parse_yaml, read_short_text, twice

POSES = "calib_cam_to_pose.txt"


def read_kitti360(content: Any, name: str) -> Calibration:
    """Return one camera of `model_type: MEI`; raise ValueError naming the key that is missing or wrong."""
    content = mapping(content, "the content")
    model = required(content, "model_type")
    if model != "MEI":
        raise ValueError(f"model_type is {model!r}; only MEI of CamOdoCal's models is supported")
    mirror, distortion, projection = (
        mapping(required(content, key), key)
        for key in ("mirror_parameters", "distortion_parameters", "projection_parameters")
    )
    camera = MEI(
        whole(content, "image_width"),
        whole(content, "image_height"),
        (number(projection, "gamma1"), number(projection, "gamma2")),
        (number(projection, "u0"), number(projection, "v0")),
        number(mirror, "xi"),
        tuple(number(distortion, key) for key in ("k1", "k2", "p1", "p2")),
        max_angle_deg=180.0,
    )
    return single(camera, str(content.get("camera_name", name)))


def read_kitti360_folder(folder: Path) -> Calibration:
    """Return the fisheye cameras of a `calibration` folder with their poses.

    The poses are in the IMU frame (x forward, y right, z down). The ego frame has the same x axis, opposite y and
    z axes, and its origin at the mean position of the cameras.

    Raises:
        ValueError: naming the file and the wrong value.
    """
    files = sorted(folder.glob("image_*.yaml"))
    if not files:
        raise ValueError(f"{folder}: {POSES} exists but no image_02.yaml; download KITTI-360's calibration")
    imu_from_camera = _poses(folder / POSES)
    ego_from_imu = torch.diag(torch.tensor([1.0, -1, -1, 1], dtype=torch.float64))
    cameras, poses = [], []
    for file in files:
        with naming(str(file)):
            cameras.append(read_kitti360(parse_yaml(read_short_text(file)), file.stem).cameras[0])
        if file.stem not in imu_from_camera:
            raise ValueError(f"{folder / POSES}: {file.stem} is missing; it holds {', '.join(imu_from_camera)}")
        poses.append(ego_from_imu @ imu_from_camera[file.stem])
    names = tuple(file.stem for file in files)
    return Calibration(tuple(cameras), centered(torch.stack(poses)), names, None)


def _poses(file: Path) -> dict[str, torch.Tensor]:
    with naming(str(file)):
        lines = [line.partition(":") for line in read_short_text(file).splitlines()]
        named = [(name.strip(), values.split()) for name, _, values in lines if values]
        if name := twice(name for name, _ in named):
            raise ValueError(f"the pose of {name} stands twice; keep one")
        return {name: pose([words[i : i + 4] for i in range(0, len(words), 4)], name) for name, words in named}
