"""Simple solids as meshes, in the frame of their thing; faces are counter-clockwise seen from outside."""

from typing import NamedTuple

import numpy as np

from omniocc.world.material import Material
from omniocc.world.mesh import Mesh, concatenate

Color = tuple[int, int, int]
_MIN_AREA_M2 = 1e-6


class Skin(NamedTuple):
    """What a surface is and looks like: class id, material and base colour."""

    label: int
    material: Material
    color: Color


def triangles(corners_m: np.ndarray, uv_m: np.ndarray, skin: Skin) -> Mesh:
    """A mesh of (T, 3, 3) corners with (T, 3, 2) texture coordinates; slivers (collapsed quads) are left out."""
    normal = np.cross(corners_m[:, 1] - corners_m[:, 0], corners_m[:, 2] - corners_m[:, 0])
    keep = np.linalg.norm(normal, axis=1) > 2 * _MIN_AREA_M2
    corners_m, uv_m = corners_m[keep], uv_m[keep]
    count = len(corners_m)
    return Mesh(
        corners_m.reshape(-1, 3).astype(np.float32),
        np.arange(3 * count, dtype=np.int32).reshape(count, 3),
        uv_m.astype(np.float32),
        np.full(count, skin.label, np.uint8),
        np.full(count, skin.material, np.uint8),
        np.tile(np.asarray(skin.color, np.uint8), (count, 1)),
        np.full(count, -1, np.int32),
    )


def quads(corners_m: np.ndarray, uv_m: np.ndarray, skin: Skin) -> Mesh:
    """Two triangles for each of (Q, 4, 3) corners; a quad may collapse to a triangle."""
    split = np.array([[0, 1, 2], [0, 2, 3]])
    return triangles(corners_m[:, split].reshape(-1, 3, 3), uv_m[:, split].reshape(-1, 3, 2), skin)


_BOX_FACES = np.array([[0, 1, 5, 4], [1, 3, 7, 5], [3, 2, 6, 7], [2, 0, 4, 6], [4, 5, 7, 6], [2, 3, 1, 0]])


def box(
    size_m: tuple[float, float, float], center_m: tuple[float, float, float], skin: Skin, top: Skin | None = None
) -> Mesh:
    """A cuboid. Side faces have u along the wall and v = height above the frame's z = 0; `top` skins its upper face."""
    signs = np.array([[x, y, z] for z in (-0.5, 0.5) for y in (-0.5, 0.5) for x in (-0.5, 0.5)])
    corners = (signs * size_m + center_m)[_BOX_FACES]
    uv = np.empty((6, 4, 2))
    uv[[0, 2]], uv[[1, 3]], uv[4:] = corners[[0, 2]][..., [0, 2]], corners[[1, 3]][..., [1, 2]], corners[4:][..., :2]
    if top is None:
        return quads(corners, uv, skin)
    return concatenate([quads(corners[[0, 1, 2, 3, 5]], uv[[0, 1, 2, 3, 5]], skin), quads(corners[4:5], uv[4:5], top)])


def sheet(points_m: np.ndarray, uv_m: np.ndarray, skin: Skin) -> Mesh:
    """Quads between neighbours of a (rows, columns, 3) net.

    The outer side is the one from which columns run to the right and rows upwards.
    """

    def cells(net: np.ndarray) -> np.ndarray:
        return np.stack([net[:-1, :-1], net[:-1, 1:], net[1:, 1:], net[1:, :-1]], 2).reshape(-1, 4, net.shape[-1])

    return quads(cells(points_m), cells(uv_m), skin)


def lathe(
    radius_m: list[float], height_m: list[float], sides: int, skin: Skin, center_m: tuple[float, float] = (0.0, 0.0)
) -> Mesh:
    """A profile from bottom to top turned around a vertical axis; a radius of 0 closes an end."""
    angle = np.linspace(0, 2 * np.pi, sides + 1)
    radius, height = np.asarray(radius_m, float)[:, None], np.asarray(height_m, float)[:, None]
    x, y = center_m[0] + radius * np.cos(angle), center_m[1] + radius * np.sin(angle)
    ring = np.stack([x, y, np.broadcast_to(height, x.shape)], -1)
    steps = np.hypot(np.diff(radius[:, 0]), np.diff(height[:, 0]))
    length = height[0] + np.concatenate([[0], np.cumsum(steps)])
    uv = np.stack(np.meshgrid(angle * radius.max(), length), -1)
    return sheet(ring, uv, skin)


def beam(start_m: tuple[float, float, float], end_m: tuple[float, float, float], radius_m: float, skin: Skin) -> Mesh:
    """A four-sided bar between two points, open at its ends."""
    start, end = np.asarray(start_m, float), np.asarray(end_m, float)
    axis = (end - start) / np.linalg.norm(end - start)
    helper = np.array([0.0, 0, 1]) if abs(axis[2]) < 0.9 else np.array([1.0, 0, 0])
    right = np.cross(axis, helper)
    right /= np.linalg.norm(right)
    up = np.cross(axis, right)
    angle = np.pi / 4 + np.pi / 2 * np.arange(5)
    around = radius_m * (np.cos(angle)[:, None] * right + np.sin(angle)[:, None] * up)
    net = np.stack([start + around, end + around])
    uv = np.stack(np.meshgrid(radius_m * 1.4 * np.arange(5), [0.0, float(np.linalg.norm(end - start))]), -1)
    return sheet(net, uv, skin)


def prism(outline_m: np.ndarray, bottom_m: float, top_m: float, wall: Skin, cap: Skin) -> Mesh:
    """Walls over a counter-clockwise (P, 2) outline that its centroid sees whole, with a flat cap.

    Walls have u along the outline and v = height above the frame's z = 0.
    """
    closed = np.concatenate([outline_m, outline_m[:1]])
    along = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(closed, axis=0), axis=1))])
    net = np.stack([np.column_stack([closed, np.full(len(closed), z)]) for z in (bottom_m, top_m)])
    uv = np.stack(np.meshgrid(along, [bottom_m, top_m]), -1)
    return concatenate([sheet(net, uv, wall), fan(net[1, :-1], cap)])


def fan(rim_m: np.ndarray, skin: Skin) -> Mesh:
    """A face over a closed counter-clockwise (P, 3) rim from its mean point, uv from x and y."""
    following = np.roll(rim_m, -1, 0)
    middle = np.broadcast_to(rim_m.mean(0), rim_m.shape)
    corners = np.stack([middle, rim_m, following], 1)
    return triangles(corners, corners[..., :2], skin)


def blob(
    rng: np.random.Generator, radius_m: tuple[float, float, float], center_m: tuple[float, float, float],
    skin: Skin, roughness: float = 0.18, sides: int = 7, rows: int = 5,
) -> Mesh:  # fmt: skip
    """A lumpy ellipsoid, for crowns, bushes and heads. `roughness` is the noise as a share of the radius."""
    polar, angle = np.linspace(-np.pi / 2, np.pi / 2, rows)[:, None], np.linspace(0, 2 * np.pi, sides + 1)[None]
    scale = 1 + roughness * rng.uniform(-1, 1, (rows, sides + 1))
    scale[:, -1] = scale[:, 0]
    scale[[0, -1]] = 1
    twist = angle + np.pi / sides * (np.arange(rows)[:, None] % 2)
    unit = np.stack(
        np.broadcast_arrays(np.cos(polar) * np.cos(twist), np.cos(polar) * np.sin(twist), np.sin(polar)), -1
    )
    points = unit * scale[..., None] * radius_m + center_m
    uv = np.stack(np.broadcast_arrays(angle * radius_m[0], polar * radius_m[2]), -1)
    return sheet(points, uv, skin)


def loft(profile_m: np.ndarray, half_width_m: np.ndarray, across: list[Skin], side: Skin) -> Mesh:
    """A body between two mirrored side outlines.

    Args:
        profile_m: (P, 2) counter-clockwise outline in (x, z), seen from -y (the body's right side).
        half_width_m: (P,) half width along y at every point.
        across: skin of the strip after every point; P of them.
        side: skin of both sides.
    """
    x, z = profile_m.T
    right, left = np.stack([x, -half_width_m, z], 1), np.stack([x, half_width_m, z], 1)
    meshes = []
    for i, skin in enumerate(across):
        j = (i + 1) % len(across)
        length = float(np.hypot(*(profile_m[j] - profile_m[i])))
        corners = np.stack([right[i], right[j], left[j], left[i]])[None, ::-1]
        uv = np.array(
            [[half_width_m[i], 0], [half_width_m[j], length], [-half_width_m[j], length], [-half_width_m[i], 0]]
        )
        meshes.append(quads(corners, uv[None, ::-1], skin))
    for rim in (right, left[::-1]):
        corners = np.stack([np.broadcast_to(rim.mean(0), rim.shape), rim, np.roll(rim, -1, 0)], 1)
        meshes.append(triangles(corners, corners[..., [0, 2]], side))
    return concatenate(meshes)


def similarity(position_m: np.ndarray, yaw_rad: np.ndarray, scale: np.ndarray | float = 1.0) -> np.ndarray:
    """(K, 4, 4) poses of upright things at (K, 3) positions, turned by (K,) yaw and scaled."""
    cos, sin, scale = np.cos(yaw_rad), np.sin(yaw_rad), np.broadcast_to(np.asarray(scale, float), np.shape(yaw_rad))
    pose = np.zeros((len(position_m), 4, 4))
    pose[:, 0, 0], pose[:, 0, 1] = scale * cos, -scale * sin
    pose[:, 1, 0], pose[:, 1, 1] = scale * sin, scale * cos
    pose[:, 2, 2], pose[:, 3, 3] = scale, 1
    pose[:, :3, 3] = position_m
    return pose
