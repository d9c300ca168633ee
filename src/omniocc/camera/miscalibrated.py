"""Rigs whose calibration is wrong: poses and focal lengths, by an exact amount, in given or random directions."""

from collections.abc import Sequence
from dataclasses import fields, replace
from typing import Any, cast

import numpy as np
import torch
from jaxtyping import Float64
from torch import Tensor

from omniocc.camera.protocol import Camera
from omniocc.camera.rig import Rig

STEPS = 10_000
"""Factors on a focal length are rounded to multiples of 1 / STEPS."""


def turn_cameras(rig: Rig, rng: np.random.Generator, angle_deg: float) -> Rig:
    """Return the rig with every camera turned by an angle around a random axis of its own."""
    return turned(rig, _directions(rig, rng), angle_deg)


def move_cameras(rig: Rig, rng: np.random.Generator, distance_m: float) -> Rig:
    """Return the rig with every camera moved by a distance in a random direction of its own."""
    return displaced_rig(rig, _directions(rig, rng), distance_m)


def scale_focal_lengths(rig: Rig, rng: np.random.Generator, percent: float) -> Rig:
    """Return the rig with the focal length of every camera `percent` too long or too short, as likely as not.

    Raises:
        ValueError: naming the camera model whose images have no centre.
    """
    signs = rng.choice((-1.0, 1.0), len(rig.cameras))
    return with_focal_factors(rig, (1 + signs * percent / 100).tolist())


def _directions(rig: Rig, rng: np.random.Generator) -> Float64[Tensor, "N 3"]:
    """Return a random direction for each camera, evenly spread over the sphere."""
    return torch.from_numpy(rng.standard_normal((len(rig.cameras), 3)))


def turned(rig: Rig, axes: Float64[Tensor, "N 3"], angle_deg: float) -> Rig:
    """Return the rig with every camera turned about its own centre by an angle, around an axis of the camera frame."""
    poses = rig.ego_from_camera.clone()
    poses[:, :3, :3] = poses[:, :3, :3] @ rotations(axes, angle_deg)
    return replace(rig, ego_from_camera=poses)


def displaced_rig(rig: Rig, directions: Float64[Tensor, "N 3"], distance_m: float) -> Rig:
    """Return the rig with every camera moved by a distance along a direction of the ego frame."""
    poses = rig.ego_from_camera.clone()
    poses[:, :3, 3] += distance_m * directions / directions.norm(dim=-1, keepdim=True)
    return replace(rig, ego_from_camera=poses)


def with_focal_factors(rig: Rig, factors: Sequence[float]) -> Rig:
    """Return the rig with the focal length of every camera multiplied by a factor.

    Raises:
        ValueError: naming the camera model whose images have no centre.
    """
    pairs = zip(rig.cameras, factors, strict=True)
    return replace(rig, cameras=tuple(with_focal_factor(camera, factor) for camera, factor in pairs))


def has_centre(camera: Camera) -> bool:
    """Return whether a lens model has an optical centre; images of panoramas have none."""
    return "center_px" in {field.name for field in fields(cast(Any, camera))}


def with_focal_factor(camera: Camera, factor: float) -> Camera:
    """Return a camera whose pixels are `factor` times as far from its optical centre, for every lens model.

    The image keeps its size and centre: the camera is scaled on a canvas so large that its size stays whole.

    Raises:
        ValueError: naming the camera model whose images have no centre.
    """
    if not has_centre(camera):
        raise ValueError(f"{type(camera).__name__} has no centre, so that no focal length could be wrong")
    width, height = camera.width, camera.height
    canvas = cast(Camera, replace(cast(Any, camera), width=STEPS * width, height=STEPS * height))
    steps = round(factor * STEPS)
    scaled = canvas.resized(steps * width, steps * height)
    return replace(cast(Any, scaled), width=width, height=height, center_px=cast(Any, camera).center_px)


def rotations(axes: Float64[Tensor, "N 3"], angle_deg: float) -> Float64[Tensor, "N 3 3"]:
    """Return the rotations by an angle around axes of any length."""
    x, y, z = (torch.deg2rad(axes.new_tensor(angle_deg)) * axes / axes.norm(dim=-1, keepdim=True)).unbind(-1)
    zero = torch.zeros_like(x)
    rows = [torch.stack(row, -1) for row in ((zero, -z, y), (z, zero, -x), (-y, x, zero))]
    return torch.linalg.matrix_exp(torch.stack(rows, -2))
