"""Reader of OmniMVS's `config.yaml`: four OCam cameras with poses."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float64
from torch import Tensor

from omniocc.camera.calibration.fields import (
    Calibration,
    mapping,
    naming,
    number,
    read_mask_of,
    required,
    row,
    size,
)
from omniocc.camera.calibration.ocamcalib import counted
from omniocc.camera.models.ocam import OCam
from omniocc.camera.pose import LEVEL_FORWARD, rigid_pose


def read_omnimvs(content: dict[str, Any], folder: Path) -> Calibration:
    """Return cameras from `poly`, `inv_poly`, `center`, `affine`, `image_size`, `max_fov` and `pose`.

    A pose is a rotation vector and a position in metres, camera to rig; the rig frame (x right, y down, z forward) is
    rotated into the ego frame. An `invalid_mask` is used if the file exists: not 0 where the image is unusable.

    Raises:
        ValueError: naming the camera and the key.
    """
    cameras, poses, names, masks = [], [], [], []
    for index, entry in enumerate(required(content, "cameras")):
        name = f"cam{mapping(entry, f'cameras[{index}]').get('cam_id', index + 1)}"
        with naming(name):
            cameras.append(_camera(entry))
            poses.append(_pose(row(entry, 6, "pose")))
            masks.append(_mask(folder / str(entry.get("invalid_mask", "")), cameras[-1]))
        names.append(name)
    if not cameras:
        raise ValueError("cameras is an empty list; is the file whole?")
    kept = None if all(mask is None for mask in masks) else tuple(masks)
    return Calibration(tuple(cameras), torch.stack(poses), tuple(names), kept)


def _camera(entry: dict[str, Any]) -> OCam:
    if entry.get("model", "ocam") != "ocam":
        raise ValueError(f"model is {entry['model']!r}; an OmniMVS config holds ocam only")
    height, width = size(entry, "image_size")
    center_row, center_column = row(entry, 2, "center")
    return OCam(
        width,
        height,
        (center_column, center_row),
        counted("poly", row(entry, None, "poly")),
        counted("inv_poly", row(entry, None, "inv_poly")),
        tuple(row(entry, 3, "affine")),
        number(entry, "max_fov") / 2,
    )


def _pose(values: list[float]) -> Float64[Tensor, "4 4"]:
    ego_from_rig = torch.tensor(LEVEL_FORWARD, dtype=torch.float64)
    rig_from_camera = torch.from_numpy(cv2.Rodrigues(np.array(values[:3]))[0])
    return rigid_pose(ego_from_rig @ rig_from_camera, ego_from_rig @ torch.tensor(values[3:], dtype=torch.float64))


def _mask(file: Path, camera: OCam) -> Bool[Tensor, "_ _"] | None:
    if not file.is_file():
        return None
    return ~read_mask_of("invalid_mask", file, camera)
