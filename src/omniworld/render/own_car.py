"""The pixels in which a rig's cameras see their own car: drawn, but masked for whoever uses the images."""

from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
import torch
from jaxtyping import Bool
from torch import Tensor

from omniocc.camera import Rig
from omniocc.errors import UserError
from omniworld.assets.vehicle import EGO_ROAD_M, ego_car
from omniworld.mesh.mesh import Mesh, empty, transform
from omniworld.render.caster import Caster

Masks = tuple[Bool[Tensor, "_ _"], ...]
BORDER_PX = 3
"""Pixels around the own car that are drawn although they are masked."""


def road_of(rig: Rig) -> float:
    """Return the height of the road in a rig's frame, m; that of the virtual world's car where it is not known."""
    return EGO_ROAD_M if rig.road_z_m is None else rig.road_z_m


def car_under(rig: Rig) -> Mesh:
    """Return the own car in the frame of a rig on it; empty for a rig with a camera inside of the car's body."""
    down = np.eye(4)
    down[2, 3] = road_of(rig) - EGO_ROAD_M
    car = transform(ego_car(), down)
    low, high = car.vertices.min(0), car.vertices.max(0)
    places_m = rig.ego_from_camera[:, :3, 3].numpy()
    inside = ((places_m > low) & (places_m < high)).all(1)
    return empty() if inside.any() else car


def own_car_pixels(rig: Rig, car: Mesh) -> Masks:
    """Return for every camera (height, width) whether the ray through a pixel's centre hits the car, masks ignored.

    The car is in the ego frame, m.
    """
    caster, bare = Caster(car), replace(rig, masks=None)
    found = []
    for camera in range(len(rig.cameras)):
        directions, valid = bare.rays(camera)
        origin_m = rig.ego_from_camera[camera, :3, 3].numpy().astype(np.float32)
        hits = caster.cast(origin_m[None], directions[valid].numpy())
        pixels = torch.zeros_like(valid)
        pixels[valid] = torch.from_numpy(hits.face >= 0)
        found.append(pixels)
    return tuple(found)


def grown(pixels: Masks, by_px: int) -> Masks:
    """Return the pixels and all around them up to `by_px`, also diagonally."""
    kernel = np.ones((2 * by_px + 1, 2 * by_px + 1), np.uint8)
    return tuple(torch.from_numpy(cv2.dilate(part.numpy().astype(np.uint8), kernel)).bool() for part in pixels)


def masking(rig: Rig, pixels: Masks) -> Rig:
    """Return the rig with these pixels masked too."""
    old = rig.masks or (None,) * len(pixels)
    masks = [~part if mask is None else mask & ~part for mask, part in zip(old, pixels, strict=True)]
    return replace(rig, masks=tuple(None if bool(mask.all()) else mask for mask in masks))


@lru_cache(maxsize=4)
def mask_ego_car(rig: Rig) -> Rig:
    """Return the rig with the pixels masked in which the virtual world's car is seen."""
    return masking(rig, own_car_pixels(rig, car_under(rig)))


def show_ego_car(rig: Rig) -> Rig:
    """Return the rig without the part of its masks that the virtual world's car covers: images show the car.

    Masks that were made at another size of image do not end where the car does, which `BORDER_PX` allows for.
    """
    if rig.masks is None:
        return rig
    seen = grown(own_car_pixels(rig, car_under(rig)), BORDER_PX)
    return replace(rig, masks=tuple(m if m is None else m | part for m, part in zip(rig.masks, seen, strict=True)))


def read_obj(path: Path) -> Mesh:
    """Return the surfaces of a Wavefront OBJ file as triangles; only corners (`v`) and faces (`f`) are read.

    Raises:
        UserError: naming the file, and the line that cannot be read.
    """
    corners: list[list[float]] = []
    faces: list[tuple[int, int, int]] = []
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise UserError(f"{path} cannot be read as a Wavefront OBJ file: {error}") from error
    for number, line in enumerate(lines, start=1):
        kind, *words = line.split() or [""]
        try:
            if kind == "v":
                x, y, z = map(float, words[:3])
                corners.append([x, y, z])
            elif kind == "f":
                ring = [_corner(word, len(corners)) for word in words]
                faces += [(ring[0], ring[k], ring[k + 1]) for k in range(1, len(ring) - 1)]
        except (ValueError, IndexError) as error:
            raise UserError(f"{path}, line {number}: '{line.strip()}' is not a corner or face ({error})") from error
    if not faces:
        raise UserError(f"{path} has no faces; export the car's surface as triangles or polygons in an OBJ file")
    mesh = empty()
    return replace(mesh, vertices=np.array(corners, np.float32), faces=np.array(faces, np.int32))


def _corner(word: str, count: int) -> int:
    """Return the index of a corner, from 0, given `12` or `12/3/4`, from 1, or `-1`, counted from the last one."""
    number = int(word.split("/")[0])
    index = number - 1 if number > 0 else count + number
    if not 0 <= index < count:
        raise IndexError(f"there is no corner {number} yet")
    return index
