"""Files with the ego pose of every frame of a sequence.

A text file with one line per frame: the frame's name (that of its folder) and `world_from_ego`, either as a position
and a unit quaternion or as the rows of a 4x4 matrix. A header may name these columns in another order, see
`omniocc.data.formats.pose_table`:

    frame,x_m,y_m,z_m,qw,qx,qy,qz
    0000,0.0,0.0,0.0,1,0,0,0
    0001,4.2,0.1,0.0,0.9998477,0,0,0.0174524

Ego: x forward, y left, z up, origin as in the rig file. World: any fixed coordinate frame in metres.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float64
from torch import Tensor

from omniocc.data.formats.pose_table import W_FIRST, read_table
from omniocc.data.formats.poses import TOLERANCE, check_position, is_euroc, quaternion_pose
from omniocc.errors import UserError
from omniocc.io import atomic_write, number_of
from omniocc.predict.input.images import suggest_name

QUATERNION = ("x_m", "y_m", "z_m", "qw", "qx", "qy", "qz")
MATRIX = tuple(f"m{row}{column}" for row in range(4) for column in range(4))


def read_poses(path: Path, frames: Sequence[str]) -> Float64[Tensor, "F 4 4"]:
    """Return `world_from_ego` of the named frames, in their order; the file may hold other frames too.

    Raises:
        UserError: naming the line that is not a pose, or the frame without one.
        DataError: naming the file that cannot be read, or is no text, or the header that does not name a pose.
    """
    poses: dict[str, Tensor] = {}
    for row in read_table(path, ("frame",), W_FIRST):
        (name,) = row.keys
        if name in poses:
            raise UserError(f"{row.where}: frame '{name}' already has a pose; keep one")
        try:
            poses[name] = _pose(row.pose)
        except ValueError as error:
            raise UserError(f"{row.where}, frame '{name}': {error}") from error
    for name in frames:
        if name not in poses:
            hint = suggest_name(name, poses) or f"; its first frames are {', '.join(list(poses)[:3])}"
            raise UserError(f"{path} has no pose of frame '{name}'{hint if poses else ''}")
    return torch.stack([poses[name] for name in frames])


def write_poses(path: Path, frames: Sequence[str], world_from_ego: Float64[Tensor, "F 4 4"]) -> None:
    """Write poses as matrices without rounding: `read_poses` returns equal values.

    Raises:
        DataError: naming the file that cannot be written.
    """
    lines = [",".join(("frame", *MATRIX))]
    for name, pose in zip(frames, world_from_ego, strict=True):
        lines.append(",".join((name, *(repr(value) for value in pose.flatten().tolist()))))
    atomic_write(path, "\n".join([*lines, ""]))


def _pose(words: Sequence[str]) -> Float64[Tensor, "4 4"]:
    values = [number_of(word) for word in words]
    if len(values) == len(QUATERNION) or is_euroc(values):
        return torch.from_numpy(quaternion_pose(values[3:7], values[:3], "the pose"))
    if len(values) == len(MATRIX):
        return _from_rows(values)
    raise ValueError(
        f"{len(values)} numbers; give {len(QUATERNION)} ({','.join(QUATERNION)}) or the {len(MATRIX)} of a 4x4 matrix, "
        "row by row, separated by commas"
    )


def _from_rows(values: Sequence[float]) -> Float64[Tensor, "4 4"]:
    check_position(np.array(values[3:12:4]), "the pose")
    pose = torch.tensor(values, dtype=torch.float64).view(4, 4)
    rotation = pose[:3, :3]
    error = float((rotation @ rotation.T - torch.eye(3, dtype=torch.float64)).abs().max())
    if error > TOLERANCE or float(torch.linalg.det(rotation)) < 0 or pose[3].tolist() != [0, 0, 0, 1]:
        raise ValueError(
            f"the matrix is not a rigid pose: its 3x3 part must be a rotation (off by {error:.3g}), its last row "
            "0,0,0,1"
        )
    return pose
