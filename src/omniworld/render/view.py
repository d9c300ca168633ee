"""The rays of one camera in the ego frame, and their hits on the ego car; both are the same in every frame."""

from dataclasses import dataclass

import numpy as np
import torch

from omniocc.camera import Rig
from omniworld.render.caster import Caster, Hits
from omniworld.render.cull import Cones, make_cones

_TILES = 32  # number of tiles across the image


@dataclass(frozen=True)
class View:
    """One camera's P visible pixels.

    Attributes:
        size: (height, width), px.
        pixel: (P,) int64 index into the flattened image.
        right: (P,) int64 number of the pixel's right neighbour, -1 without one.
        below: (P,) int64 number of the lower neighbour, -1 without one.
        origin_m: (3,) float32, ego frame.
        center: (3, P) float32 unit directions in the ego frame through the pixels' centres.
        extra: (3, P, S-1) float32 directions through other points of the pixels, S rays per pixel in all.
        ego_center_hits: hits of the centre rays on the ego car.
        ego_extra_hits: hits of the other rays, flattened (P * (S-1)).
        pixel_rad: mean angle between neighbouring pixels.
        cones: bundles of neighbouring pixels' rays, ego frame.
        falloff: (P,) float32, 0 on the optical axis and 1 at the lens's rim.
    """

    size: tuple[int, int]
    pixel: np.ndarray
    right: np.ndarray
    below: np.ndarray
    origin_m: np.ndarray
    center: np.ndarray
    extra: np.ndarray
    ego_center_hits: Hits
    ego_extra_hits: Hits
    pixel_rad: float
    cones: Cones
    falloff: np.ndarray


def make_view(rig: Rig, camera: int, supersample: int, ego_car: Caster) -> View:
    """Return the rays of one camera, `supersample` squared for each pixel; `ego_car` is in the ego frame."""
    directions, valid = rig.rays(camera)
    height, width = valid.shape
    pixel = np.flatnonzero(valid.numpy())
    center = directions.numpy().reshape(-1, 3)[pixel]
    origin_m = rig.ego_from_camera[camera, :3, 3].numpy().astype(np.float32)
    beside = [_shifted(rig, camera, pixel, center, offset) for offset in _offsets(supersample)]
    extra = np.stack(beside, axis=1) if beside else np.empty((len(pixel), 0, 3), np.float32)
    flat = extra.reshape(-1, 3)
    number = np.full((height + 1, width + 1), -1)
    number[:-1, :-1].flat[pixel] = np.arange(len(pixel))
    right, below = number[:-1, 1:].ravel()[pixel], number[1:, :-1].ravel()[pixel]
    steps = np.linalg.norm(center[right[right >= 0]] - center[right >= 0], axis=1)
    axis = rig.ego_from_camera[camera, :3, 2].numpy()
    angle = np.arccos(np.clip(center @ axis, -1, 1))
    return View(
        (height, width),
        pixel,
        right,
        below,
        origin_m,
        np.ascontiguousarray(center.T),
        extra=np.ascontiguousarray(np.moveaxis(extra, -1, 0)),
        ego_center_hits=ego_car.cast(origin_m[None], center),
        ego_extra_hits=ego_car.cast(origin_m[None], flat),
        pixel_rad=float(steps.mean()),
        cones=_tiles(pixel, (height, width), center, float(steps.max())),
        falloff=((angle / angle.max()) ** 2).astype(np.float32),
    )


def _tiles(pixel: np.ndarray, size: tuple[int, int], center: np.ndarray, step_rad: float) -> Cones:
    """Return one cone for each tile of the image, wide enough for rays beside the pixels' centres."""
    side = max(size[1] // _TILES, 1)
    number = pixel // size[1] // side * size[1] + pixel % size[1] // side
    cones = make_cones(center.T, np.unique(number, return_inverse=True)[1])
    return cones._replace(half_rad=cones.half_rad + np.float32(step_rad))


def _offsets(supersample: int) -> np.ndarray:
    """Return (S-1, 2) points of a pixel beside its centre, spread evenly over a disc."""
    count = supersample**2 - 1
    number = np.arange(1, count + 1)
    reach_px = 0.41 if count <= 3 else 0.55
    radius, turn = reach_px * np.sqrt(number / max(count, 1)), number * np.pi * (3 - np.sqrt(5))
    return np.stack([radius * np.cos(turn), radius * np.sin(turn)], axis=1)


def _shifted(rig: Rig, camera: int, pixel: np.ndarray, center: np.ndarray, offset: np.ndarray) -> np.ndarray:
    """Return (P, 3) directions beside the pixels' centres; that of the centre where the lens ends in between."""
    model = rig.cameras[camera]
    points = np.stack([pixel % model.width, pixel // model.width], axis=1) + offset
    rays, valid = model.unproject(torch.from_numpy(points))
    turned = (rays @ rig.ego_from_camera[camera, :3, :3].T).float().numpy()
    return np.where(valid.numpy()[:, None], turned, center)
