"""The paper's way to a fisheye image: faces of a cube are rendered and the fisheye's pixels looked up in them.

Simulators that rasterise, such as CARLA, can only render flat images. Here it exists to be compared with direct ray
casting (`tests/world/render/test_cubemap.py` states the error) and to make data with the same resampling blur.
"""

from dataclasses import dataclass

import numpy as np
import torch

from omniocc.camera import Pinhole, Rig
from omniocc.world.render.capture import RenderedPixels, render_pixels
from omniocc.world.render.caster import Caster
from omniocc.world.render.snapshot import Snapshot
from omniocc.world.render.view import View, make_view

_MARGIN_PX = 1  # beyond 90 degrees, so that pixels at a face's edge have neighbours to blend with
# Columns: a face's right, down and forward in the camera's frame; front, right, left, down, up, back.
_FACES = np.array([
    [[1, 0, 0], [0, 1, 0], [0, 0, 1]], [[0, 0, 1], [0, 1, 0], [-1, 0, 0]], [[0, 0, -1], [0, 1, 0], [1, 0, 0]],
    [[1, 0, 0], [0, 0, 1], [0, -1, 0]], [[1, 0, 0], [0, 0, -1], [0, 1, 0]], [[-1, 0, 0], [0, 1, 0], [0, 0, -1]],
], dtype=np.float64)  # fmt: skip


@dataclass(frozen=True)
class Cube:
    """The cube's faces around one camera, and the positions of its P pixels in them.

    Attributes:
        faces: views of the faces, restricted to the pixels that are needed.
        forward: (Q,) float32 component of each face pixel's ray along the axis of its face, face after face.
        corner: (4, P) int64 the four face pixels around each pixel, as indices into `forward`.
        weight: (4, P) float32 bilinear weights.
        nearest: (P,) int64 the closest face pixel.
        camera_forward: (P,) float32 component of each camera pixel's ray along the axis of its face.
    """

    faces: tuple[View, ...]
    forward: np.ndarray
    corner: np.ndarray
    weight: np.ndarray
    nearest: np.ndarray
    camera_forward: np.ndarray


def make_cube(rig: Rig, camera: int, view: View, supersample: int, ego_car: Caster) -> Cube:
    """Return the cube's faces for one camera, as fine as its pixels in their middle, finer elsewhere."""
    inner = int(np.ceil(2 / view.pixel_rad))
    side = inner + 2 * _MARGIN_PX
    pose = rig.ego_from_camera[camera].double().numpy()
    toward = np.einsum("ji,jp->ip", pose[:3, :3], view.center.astype(np.float64))
    along = np.einsum("fij,ip->fjp", _FACES, toward)
    face = along[:, 2].argmax(axis=0)
    x, y, z = np.moveaxis(along[face, :, np.arange(len(face))], -1, 0)
    column, row = ((part / z + 1) * inner / 2 - 0.5 + _MARGIN_PX for part in (x, y))
    left, top = np.floor(column).astype(np.int64), np.floor(row).astype(np.int64)
    right, lower = column - left, row - top
    corner = np.stack([(face * side + top + a) * side + left + b for a in (0, 1) for b in (0, 1)])
    weight = np.stack([(lower if a else 1 - lower) * (right if b else 1 - right) for a in (0, 1) for b in (0, 1)])
    needed = np.zeros((len(_FACES), side, side), dtype=bool)
    needed.reshape(-1)[corner] = True
    used = np.flatnonzero(needed.any(axis=(1, 2)))
    model = Pinhole(side, side, focal_px=(inner / 2, inner / 2), center_px=((side - 1) / 2, (side - 1) / 2))
    poses = np.tile(pose, (len(used), 1, 1))
    poses[:, :3, :3] = pose[:3, :3] @ _FACES[used]
    names, masks = tuple(f"face{number}" for number in used), tuple(torch.from_numpy(mask) for mask in needed[used])
    face_rig = Rig((model,) * len(used), torch.from_numpy(poses), names, masks)
    views = tuple(make_view(face_rig, number, supersample, ego_car) for number in range(len(used)))
    order = np.cumsum(needed.reshape(-1)) - 1
    forward = [np.einsum("i,ip->p", pose[:3, :3] @ _FACES[k, :, 2], v.center) for k, v in zip(used, views, strict=True)]
    nearest = corner[weight.argmax(axis=0), np.arange(len(face))]
    return Cube(
        views, np.concatenate(forward).astype(np.float32), order[corner], weight.astype(np.float32), order[nearest],
        z.astype(np.float32),
    )  # fmt: skip


def render_through_cube(cube: Cube, snapshot: Snapshot) -> RenderedPixels:
    """Render the cube's faces and look the camera's pixels up in them.

    Colours are blended bilinearly. Ranges are blended as inverse distances along the face's axis, which is exact on a
    plane, where all four face pixels see one surface; elsewhere, and for classes, the nearest face pixel decides.
    """
    seen = [render_pixels(face, snapshot) for face in cube.faces]
    colors = np.concatenate([part.color for part in seen], axis=1)
    key, label, range_m, ego = (
        np.concatenate([getattr(part, name) for part in seen]) for name in ("key", "label", "range_m", "ego")
    )
    color = np.einsum("ckp,kp->cp", colors[:, cube.corner], cube.weight)
    inverse = 1 / (range_m * cube.forward)
    blended = (inverse[cube.corner] * cube.weight).sum(axis=0)
    even = (key[cube.corner] == key[cube.nearest]).all(axis=0)
    with np.errstate(divide="ignore"):
        distance = 1 / (np.where(even, blended, inverse[cube.nearest]) * cube.camera_forward)
    return RenderedPixels(color, label[cube.nearest], distance, key[cube.nearest], ego[cube.nearest])
