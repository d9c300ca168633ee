"""A rig whose cameras are taken for pinholes: what a system does that knows no other lens."""

from dataclasses import replace

import torch

from omniocc.camera.models.mirrored import Mirrored
from omniocc.camera.models.pinhole import Pinhole
from omniocc.camera.protocol import Camera
from omniocc.camera.rig import Rig

STEP = 1e-4
"""Angle from the axis at which the focal lengths are measured, rad."""


def as_pinholes(rig: Rig) -> Rig:
    """Return the rig with every lens replaced by the pinhole that agrees with it on its axis; see `pinhole_of`.

    Images, poses and masks stay. It is wrong on purpose, to measure what the true lens model is worth: of a fisheye
    camera, directions far from the axis are found at other pixels, and those past 90 degrees at none.

    Raises:
        ValueError: naming the camera whose optical axis is not in its image.
    """
    cameras = []
    for name, camera in zip(rig.names, rig.cameras, strict=True):
        try:
            cameras.append(pinhole_of(camera))
        except ValueError as error:
            raise ValueError(f"camera '{name}' cannot be taken for a pinhole: {error}") from error
    return replace(rig, cameras=tuple(cameras))


def pinhole_of(camera: Camera) -> Camera:
    """Return the pinhole camera with the same size, principal point, and focal lengths on the optical axis.

    Of a mirrored camera it is the mirrored pinhole of the original one.

    Raises:
        ValueError: if the optical axis is not in the image.
    """
    if isinstance(camera, Mirrored):
        return Mirrored(pinhole_of(camera.camera))
    tilts = [(0.0, 0.0), (STEP, 0.0), (-STEP, 0.0), (0.0, STEP), (0.0, -STEP)]
    pixels, valid = camera.project(torch.tensor([[x, y, 1.0] for x, y in tilts], dtype=torch.float64))
    if not valid.all():
        raise ValueError("its optical axis is not in its image")
    center, right, left, down, up = pixels
    focal_px = (float(right[0] - left[0]) / (2 * STEP), float(down[1] - up[1]) / (2 * STEP))
    return Pinhole(camera.width, camera.height, focal_px, (float(center[0]), float(center[1])))
