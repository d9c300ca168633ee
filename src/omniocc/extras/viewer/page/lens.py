"""Tables of directions, from which the page finds the ray of a pixel without a lens model."""

import itertools
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Bool, Float64, Int16

from omniocc.camera import Rig

STEPS = (64, 32, 16, 8, 4, 2, 1)
"""Distances between the pixels of a table, px; the largest that is exact enough is taken."""
LARGEST_ERROR_DEG = 0.04
"""Between an interpolated direction and the lens model's, over all pixels that the camera sees."""
QUICK = 61
"""A table is first tried on each so manieth pixel."""
UNIT = 32767
"""Length of a direction in a table."""


class DirectionTable(NamedTuple):
    """Directions of one camera's pixels.

    Attributes:
        step: distance between neighbouring entries, px; the first is the centre of pixel (0, 0).
        directions: ego frame, times `UNIT`; linear interpolation between entries gives the direction of any pixel.
        valid: pixels that the lens sees and the mask does not hide.
        error_deg: largest error found.
    """

    step: int
    directions: Int16[np.ndarray, "rows columns 3"]
    valid: Bool[np.ndarray, "height width"]
    error_deg: float


def direction_table(rig: Rig, camera: int) -> DirectionTable:
    """Return the coarsest table of a camera whose error is at most `LARGEST_ERROR_DEG`, else one of every pixel."""
    exact, valid = rig.rays(camera)
    exact, valid = exact.double().numpy(), valid.numpy()
    v, u = np.nonzero(valid)
    for step, continued in itertools.product(STEPS, (False, True)):
        table, error_deg = _entries(rig, camera, step, continued), 0.0
        for every in (QUICK, 1):
            rows, columns = v[::every], u[::every]
            found = interpolate(table, step, columns, rows)
            error_deg = float(_angle_deg(found, exact[rows, columns]).max(initial=0.0))
            if error_deg > LARGEST_ERROR_DEG and step > STEPS[-1]:
                break
        else:
            return DirectionTable(step, table, valid, error_deg)
    raise AssertionError("the last of STEPS is always taken")


def interpolate(
    table: Int16[np.ndarray, "rows columns 3"], step: int, u: np.ndarray, v: np.ndarray
) -> Float64[np.ndarray, "P 3"]:
    """Return the unit directions of pixels as `static/lens.js` finds them."""
    columns = np.clip(np.floor(u / step), 0, table.shape[1] - 2).astype(int)
    rows = np.clip(np.floor(v / step), 0, table.shape[0] - 2).astype(int)
    right, below = (u / step - columns)[:, None], (v / step - rows)[:, None]
    upper = table[rows, columns] * (1 - right) + table[rows, columns + 1] * right
    lower = table[rows + 1, columns] * (1 - right) + table[rows + 1, columns + 1] * right
    mixed = upper * (1 - below) + lower * below
    return mixed / np.linalg.norm(mixed, axis=1, keepdims=True)


def _entries(rig: Rig, camera: int, step: int, continued: bool) -> Int16[np.ndarray, "rows columns 3"]:
    """Return the directions at every `step` pixels, up to the image's last pixel or the first entry beyond it.

    Beyond the lens's field of view they are those of its model, or those inside it continued linearly: some models end
    there, and pixels at the border lie between entries on both sides.
    """
    model = rig.cameras[camera]
    columns, rows = (max(-(-(size - 1) // step), 1) + 1 for size in (model.width, model.height))
    v, u = torch.meshgrid(torch.arange(rows), torch.arange(columns), indexing="ij")
    rays, valid = model.unproject(torch.stack([u, v], dim=-1).double() * step)
    directions = (rays @ rig.ego_from_camera[camera, :3, :3].T).numpy()
    for _ in range(2 if continued else 0):
        directions, valid = _continued(directions, np.asarray(valid))
    length = np.maximum(np.linalg.norm(directions, axis=-1, keepdims=True), 1.0)
    return (directions / length * UNIT).round().astype(np.int16)


def _continued(directions: np.ndarray, valid: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the entries with those beside the lens's field of view continued linearly from their neighbours in it."""
    total, count = np.zeros_like(directions), np.zeros(valid.shape)
    for axis in (0, 1):
        for side in (1, -1):
            near, far = (np.roll(directions, side * by, axis) for by in (1, 2))
            known = np.roll(valid, side, axis) & np.roll(valid, 2 * side, axis)
            ends = [slice(None)] * 2
            ends[axis] = slice(0, 2) if side > 0 else slice(-2, None)
            known[tuple(ends)] = False  # np.roll took them from the other end
            total += np.where(known[..., None], 2 * near - far, 0)
            count += known
    new = ~valid & (count > 0)
    mean = total / np.maximum(count, 1)[..., None]
    return np.where(new[..., None], mean, directions), valid | new


def _angle_deg(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    second = second / np.linalg.norm(second, axis=-1, keepdims=True)
    return np.degrees(2 * np.arcsin(np.clip(np.linalg.norm(first - second, axis=-1) / 2, 0, 1)))
