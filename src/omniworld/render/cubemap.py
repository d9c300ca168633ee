"""The paper's way to a fisheye image: faces of a cube are rendered and the fisheye's pixels looked up in them.

Simulators that rasterise, such as CARLA, can only render flat images. Here it exists to be compared with direct ray
casting (`tests/omniworld/render/test_cubemap.py` states the error) and to make data with the same resampling blur.
"""

from dataclasses import dataclass, replace

import numpy as np
import torch

from omniocc.camera import Pinhole, Rig
from omniocc.camera.cubemap import FACES, CubeLookup, blend_ranges, look_up_rays
from omniworld.render.capture import RenderedPixels, render_pixels
from omniworld.render.caster import Caster
from omniworld.render.snapshot import Snapshot
from omniworld.render.view import View, make_view


@dataclass(frozen=True)
class Cube:
    """The cube's faces around one camera, and the positions of its P pixels in them.

    Attributes:
        faces: views of the faces, restricted to the pixels that are needed.
        forward: (Q,) float32 component of each face pixel's ray along the axis of its face, face after face.
        lookup: places of the P pixels among these Q.
    """

    faces: tuple[View, ...]
    forward: np.ndarray
    lookup: CubeLookup


def make_cube(rig: Rig, camera: int, view: View, supersample: int, ego_car: Caster) -> Cube:
    """Return the cube's faces for one camera, as fine as its pixels in their middle, finer elsewhere."""
    pose = rig.ego_from_camera[camera].double().numpy()
    found = look_up_rays(np.einsum("ji,jp->ip", pose[:3, :3], view.center.astype(np.float64)), view.pixel_rad)
    side, inner, needed, used = found.side, found.inner, found.needed, found.faces
    model = Pinhole(side, side, focal_px=(inner / 2, inner / 2), center_px=((side - 1) / 2, (side - 1) / 2))
    poses = np.tile(pose, (len(used), 1, 1))
    poses[:, :3, :3] = pose[:3, :3] @ FACES[used]
    names, masks = tuple(f"face{number}" for number in used), tuple(torch.from_numpy(mask) for mask in needed[used])
    face_rig = Rig((model,) * len(used), torch.from_numpy(poses), names, masks)
    views = tuple(make_view(face_rig, number, supersample, ego_car) for number in range(len(used)))
    order = np.cumsum(needed.reshape(-1)) - 1
    forward = [np.einsum("i,ip->p", pose[:3, :3] @ FACES[k, :, 2], v.center) for k, v in zip(used, views, strict=True)]
    lookup = replace(found, corner=order[found.corner], nearest=order[found.nearest])
    return Cube(views, np.concatenate(forward).astype(np.float32), lookup)


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
    corner, nearest = cube.lookup.corner, cube.lookup.nearest
    color = np.einsum("ckp,kp->cp", colors[:, corner], cube.lookup.weight)
    even = (key[corner] == key[nearest]).all(axis=0)
    distance = blend_ranges(cube.lookup, 1 / (range_m * cube.forward), even)
    return RenderedPixels(color, label[nearest], distance, key[nearest], ego[nearest])
