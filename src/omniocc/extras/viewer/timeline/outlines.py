"""Where cameras stand and what they see, as lines: right for any lens, also one that sees more than 180 degrees."""

import numpy as np
import torch

from omniocc.camera import Rig

LENGTH_M = 0.6
"""Distance of the drawn border of an image from its camera."""
STEPS = 12
"""Points along each edge of an image."""


def camera_outline(rig: Rig, camera: int) -> list[np.ndarray]:
    """Return lines (P, 3), m, ego frame: the border of a camera's image, and from the camera to its corners.

    The border is where the rays of the outermost pixels are `LENGTH_M` from the camera. Where the lens does not reach
    the edge of the image, its pixels nearest to that edge, towards the middle of the image, are taken.
    """
    model, ego_from_camera = rig.cameras[camera], rig.ego_from_camera[camera].double()
    edge = _edge(model.width, model.height)
    middle = torch.tensor([(model.width - 1) / 2, (model.height - 1) / 2], dtype=torch.float64)
    fractions = torch.linspace(1, 0, 65, dtype=torch.float64)[:, None, None]
    rays, valid = model.unproject(middle + fractions * (edge - middle))
    outermost = valid.to(torch.uint8).argmax(0)
    chosen = rays[outermost, torch.arange(len(edge))]
    start = ego_from_camera[:3, 3]
    border = (start + LENGTH_M * chosen @ ego_from_camera[:3, :3].T).numpy()
    corners = [np.stack([start.numpy(), border[k * STEPS]]) for k in range(4)]
    return [np.concatenate([border, border[:1]]), *corners]


def _edge(width: int, height: int) -> torch.Tensor:
    """Return pixels around an image, (4 * STEPS, 2): right along the top, down, left, up."""
    steps = torch.arange(STEPS, dtype=torch.float64) / STEPS
    zeros, ones = torch.zeros(STEPS, dtype=torch.float64), torch.ones(STEPS, dtype=torch.float64)
    u = torch.cat([steps, ones, 1 - steps, zeros]) * (width - 1)
    v = torch.cat([zeros, steps, ones, 1 - steps]) * (height - 1)
    return torch.stack([u, v], dim=1)
