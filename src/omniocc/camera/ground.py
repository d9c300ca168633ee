"""Pose of a calibrated camera from points of known position on the ground, such as the corners of a checkerboard."""

import cv2
import numpy as np
import torch
from jaxtyping import Float64
from torch import Tensor

from omniocc.camera.pose import invert_pose, rigid_pose
from omniocc.camera.protocol import Camera

MAX_STEPS = 30
DIFFERENCE_STEP = 1e-6  # of the central differences, in radians and metres
TOLERANCE = 1e-10  # the fit ends when no component of the pose changes by this much, in radians and metres
MIN_COSINE = 0.1  # of the angle from the virtual pinhole's axis; 84 degrees, since slopes are infinite at 90


def pose_from_ground(
    camera: Camera, pixels: Float64[Tensor, "n 2"], points_ego: Float64[Tensor, "n 3"]
) -> tuple[Float64[Tensor, "4 4"], Float64[Tensor, " n"]]:
    """Return `ego_from_camera` and the reprojection error of each point, px, from n >= 4 points of one plane.

    Pixels are first turned into rays, so that any camera model can be used. A view of a plane has two solutions for the
    pose, which OpenCV's IPPE finds (Collins and Bartoli, IJCV 2014). Each is refined by a least-squares fit of the
    pixels. Of the refined poses above the plane, the one with the smaller sum of squared errors is returned.

    Raises:
        ValueError: if there are fewer than 4 points, points on one line or off the plane, a pixel outside the lens, or
            no pose above the ground.
    """
    rays, valid = camera.unproject(pixels)
    if not bool(valid.all()):
        raise ValueError(f"the lens does not cover the pixels {pixels[~valid].tolist()}; leave them out")
    _check_plane(points_ego)
    fits = []
    for initial in _initial_poses(rays, points_ego):
        pose, errors = _refine(camera, pixels, points_ego, initial)
        if bool(pose[2, 3] > points_ego[:, 2].mean()):
            fits.append((float(errors.square().sum()), pose, errors))
    if not fits:
        raise ValueError("every pose that fits is under the ground; are pixels and points in the same order?")
    _, pose, errors = min(fits, key=lambda fit: fit[0])
    return pose, errors


def _check_plane(points_ego: Float64[Tensor, "n 3"]) -> None:
    if len(points_ego) < 4:
        raise ValueError(f"{len(points_ego)} points; a pose needs at least 4 on the ground, not all on one line")
    # extents of the points along their three principal axes, the largest first
    spread = torch.linalg.svdvals(points_ego - points_ego.mean(0))
    if spread[1] < 1e-3 * spread[0]:
        raise ValueError("all points are on one line; a pose needs points beside the line too")
    if spread[2] > 1e-6 * spread[0]:
        raise ValueError("the points are not in one plane; give points on the road only")


def _initial_poses(rays: Float64[Tensor, "n 3"], points_ego: Float64[Tensor, "n 3"]) -> list[Float64[Tensor, "4 4"]]:
    """Return both solutions of IPPE as `camera_from_ego`.

    IPPE needs the pixels of a pinhole. A virtual one at the camera, with its axis along the mean ray, gives them.
    """
    virtual_from_camera = _rotation_to_z(rays.mean(0))
    virtual_rays = rays @ virtual_from_camera.T
    ahead = virtual_rays[:, 2] > MIN_COSINE
    slopes = (virtual_rays[ahead, :2] / virtual_rays[ahead, 2:]).numpy()
    if len(slopes) < 4:
        raise ValueError(
            "fewer than 4 points are within 84 degrees of their common direction; give points that are closer together"
        )
    _, rotation_vectors, translations, _ = cv2.solvePnPGeneric(
        points_ego[ahead].numpy(), slopes[:, None], np.eye(3), None, flags=cv2.SOLVEPNP_IPPE
    )
    poses = []
    for rotation_vector, translation in zip(rotation_vectors, translations, strict=True):
        rotation = virtual_from_camera.T @ torch.from_numpy(cv2.Rodrigues(rotation_vector)[0])
        poses.append(rigid_pose(rotation, virtual_from_camera.T @ torch.from_numpy(translation[:, 0])))
    return poses


def _rotation_to_z(direction: Float64[Tensor, "3"]) -> Float64[Tensor, "3 3"]:
    """Return a rotation that takes `direction` to (0, 0, 1)."""
    front = direction / direction.norm()
    # the unit vector along the smallest component is far from parallel to `front`
    side = torch.zeros(3, dtype=torch.float64)
    side[int(front.abs().argmin())] = 1
    right = torch.linalg.cross(side, front)
    right = right / right.norm()
    return torch.stack([right, torch.linalg.cross(front, right), front])


def _refine(
    camera: Camera, pixels: Float64[Tensor, "n 2"], points_ego: Float64[Tensor, "n 3"], camera_from_ego: Tensor
) -> tuple[Float64[Tensor, "4 4"], Float64[Tensor, " n"]]:
    """Return `ego_from_camera` after a Levenberg-Marquardt fit, and the reprojection error of each point, px."""

    def residuals(change: Float64[Tensor, "6"]) -> Float64[Tensor, " m"]:
        """Return the differences of u and v, px, of all points (m = 2 n) after a change of the pose."""
        moved = _move_pose(camera_from_ego, change)
        projected, _ = camera.project(points_ego @ moved[:3, :3].T + moved[:3, 3])
        return (projected - pixels).flatten()

    no_change = torch.zeros(6, dtype=torch.float64)
    steps = DIFFERENCE_STEP * torch.eye(6, dtype=torch.float64)
    damping = 1e-3
    error = residuals(no_change)
    for _ in range(MAX_STEPS):
        jacobian = torch.stack([residuals(step) - residuals(-step) for step in steps], dim=1) / (2 * DIFFERENCE_STEP)
        normal = jacobian.T @ jacobian
        change = -torch.linalg.solve(normal + damping * normal.diagonal().diag(), jacobian.T @ error)
        trial = residuals(change)
        if trial.square().sum() > error.square().sum():
            damping *= 10
            continue
        camera_from_ego, error, damping = _move_pose(camera_from_ego, change), trial, damping / 10
        if change.abs().max() < TOLERANCE:
            break
    return invert_pose(_nearest_rigid(camera_from_ego)), error.view(-1, 2).norm(dim=-1)


def _move_pose(pose: Float64[Tensor, "4 4"], change: Float64[Tensor, "6"]) -> Float64[Tensor, "4 4"]:
    """Return the pose rotated by the rotation vector change[:3], rad, then translated by change[3:], m."""
    x, y, z = change[:3]
    zero = torch.zeros_like(x)
    skew = torch.stack([zero, -z, y, z, zero, -x, -y, x, zero]).view(3, 3)
    rotation = torch.linalg.matrix_exp(skew)
    top = torch.cat([rotation @ pose[:3, :3], (rotation @ pose[:3, 3] + change[3:])[:, None]], dim=1)
    return torch.cat([top, pose[3:]])


def _nearest_rigid(pose: Float64[Tensor, "4 4"]) -> Float64[Tensor, "4 4"]:
    """Return the pose with the nearest rotation matrix: the products of many steps have rounding errors."""
    u, _, vh = torch.linalg.svd(pose[:3, :3])
    rigid = pose.clone()
    rigid[:3, :3] = u @ vh
    return rigid
