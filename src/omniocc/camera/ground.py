"""The pose of a calibrated camera from points on the ground with known positions, such as a checkerboard cloth."""

import cv2
import numpy as np
import torch
from jaxtyping import Float64
from torch import Tensor

from omniocc.camera.pose import invert_pose, rigid_pose
from omniocc.camera.protocol import Camera

STEPS = 30  # at most; the fit ends earlier by TOLERANCE
DIFFERENCE = 1e-6  # step of the central differences, in radians and metres
TOLERANCE = 1e-10  # change of the pose, in radians and metres, at which the search ends


def pose_from_ground(
    camera: Camera, pixels: Float64[Tensor, "n 2"], points_ego: Float64[Tensor, "n 3"]
) -> tuple[Float64[Tensor, "4 4"], Float64[Tensor, " n"]]:
    """Return `ego_from_camera` from n >= 4 points of one plane, and each point's reprojection error in px.

    Pixels become rays, so any camera model and any angle works. The two poses that a plane allows (Collins and Bartoli,
    IJCV 2014, OpenCV's IPPE) are the starts of a least-squares fit of the pixels; of the results above the plane the
    one that fits better is returned.

    Raises:
        ValueError: if there are fewer than 4 points, points on one line or off the plane, a pixel outside the lens, or
            no pose above the ground.
    """
    rays, valid = camera.unproject(pixels)
    if not bool(valid.all()):
        raise ValueError(f"the lens does not cover the pixels {pixels[~valid].tolist()}; leave them out")
    _check_plane(points_ego)
    found = []
    for start in _starts(rays, points_ego):
        pose, errors = _refine(camera, pixels, points_ego, start)
        if bool(pose[2, 3] > points_ego[:, 2].mean()):
            found.append((float(errors.square().sum()), pose, errors))
    if not found:
        raise ValueError("every pose that fits is under the ground; are pixels and points in the same order?")
    _, pose, errors = min(found, key=lambda candidate: candidate[0])
    return pose, errors


def _check_plane(points_ego: Float64[Tensor, "n 3"]) -> None:
    if len(points_ego) < 4:
        raise ValueError(f"{len(points_ego)} points; a pose needs at least 4 on the ground, not all on one line")
    spread = torch.linalg.svdvals(points_ego - points_ego.mean(0))
    if spread[1] < 1e-3 * spread[0]:
        raise ValueError("all points are on one line; a pose needs points beside the line too")
    if spread[2] > 1e-6 * spread[0]:
        raise ValueError("the points are not in one plane; give points on the road only")


def _starts(rays: Float64[Tensor, "n 3"], points_ego: Float64[Tensor, "n 3"]) -> list[Float64[Tensor, "4 4"]]:
    """Return `camera_from_ego` of both poses of the plane, seen by a pinhole directed at the middle of the points."""
    virtual_from_camera = _turn_to_front(rays.mean(0))
    turned = rays @ virtual_from_camera.T
    ahead = turned[:, 2] > 0.1  # within 84 degrees of the middle; the slopes of rays farther out grow without bound
    slopes = (turned[ahead, :2] / turned[ahead, 2:]).numpy()
    if len(slopes) < 4:
        raise ValueError(
            "fewer than 4 points are within 84 degrees of their common direction; give points that are closer together"
        )
    _, turns, shifts, _ = cv2.solvePnPGeneric(
        points_ego[ahead].numpy(), slopes[:, None], np.eye(3), None, flags=cv2.SOLVEPNP_IPPE
    )
    starts = []
    for turn, shift in zip(turns, shifts, strict=True):
        rotation = virtual_from_camera.T @ torch.from_numpy(cv2.Rodrigues(turn)[0])
        starts.append(rigid_pose(rotation, virtual_from_camera.T @ torch.from_numpy(shift[:, 0])))
    return starts


def _turn_to_front(direction: Float64[Tensor, "3"]) -> Float64[Tensor, "3 3"]:
    """Return a rotation that takes `direction` to (0, 0, 1)."""
    front = direction / direction.norm()
    side = torch.zeros(3, dtype=torch.float64)
    side[int(front.abs().argmin())] = 1
    right = torch.linalg.cross(side, front)
    right = right / right.norm()
    return torch.stack([right, torch.linalg.cross(front, right), front])


def _refine(
    camera: Camera, pixels: Float64[Tensor, "n 2"], points_ego: Float64[Tensor, "n 3"], camera_from_ego: Tensor
) -> tuple[Float64[Tensor, "4 4"], Float64[Tensor, " n"]]:
    """Return the pose after a Levenberg-Marquardt fit of the pixels, and the remaining errors in px."""

    def residuals(change: Float64[Tensor, "6"]) -> Float64[Tensor, " m"]:
        moved = _moved(camera_from_ego, change)
        projected, _ = camera.project(points_ego @ moved[:3, :3].T + moved[:3, 3])
        return (projected - pixels).flatten()

    no_change = torch.zeros(6, dtype=torch.float64)
    steps = DIFFERENCE * torch.eye(6, dtype=torch.float64)
    damping = 1e-3
    error = residuals(no_change)
    for _ in range(STEPS):
        jacobian = torch.stack([residuals(step) - residuals(-step) for step in steps], dim=1) / (2 * DIFFERENCE)
        normal = jacobian.T @ jacobian
        change = -torch.linalg.solve(normal + damping * normal.diagonal().diag(), jacobian.T @ error)
        trial = residuals(change)
        if trial.square().sum() > error.square().sum():
            damping *= 10
            continue
        camera_from_ego, error, damping = _moved(camera_from_ego, change), trial, damping / 10
        if change.abs().max() < TOLERANCE:
            break
    return invert_pose(_orthonormal(camera_from_ego)), error.view(-1, 2).norm(dim=-1)


def _moved(pose: Float64[Tensor, "4 4"], change: Float64[Tensor, "6"]) -> Float64[Tensor, "4 4"]:
    """Return the pose after a rotation by the vector change[:3], in rad, and a shift by change[3:], in metres."""
    x, y, z = change[:3]
    zero = torch.zeros_like(x)
    generator = torch.stack([zero, -z, y, z, zero, -x, -y, x, zero]).view(3, 3)
    turn = torch.linalg.matrix_exp(generator)
    top = torch.cat([turn @ pose[:3, :3], (turn @ pose[:3, 3] + change[3:])[:, None]], dim=1)
    return torch.cat([top, pose[3:]])


def _orthonormal(pose: Float64[Tensor, "4 4"]) -> Float64[Tensor, "4 4"]:
    """Return the nearest rigid pose, which removes the rounding accumulated over the steps."""
    left, _, right = torch.linalg.svd(pose[:3, :3])
    rigid = pose.clone()
    rigid[:3, :3] = left @ right
    return rigid
