"""Simple solids as meshes; faces are counter-clockwise seen from outside."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from omniworld.mesh.material import Material
from omniworld.mesh.mesh import Mesh, concatenate

Color = tuple[int, int, int]
Number = float | int  # jaxtyping's run-time checks do not accept 2 for a float
Triple = tuple[Number, Number, Number]
_MIN_AREA_M2 = 1e-6


class Skin(NamedTuple):
    """Appearance and class of a surface: class id, material and base colour."""

    label: int
    material: Material
    color: Color


def triangles(corners_m: np.ndarray, uv_m: np.ndarray, skin: Skin) -> Mesh:
    """Return a mesh of (T, 3, 3) corners with (T, 3, 2) texture coordinates, without slivers."""
    count = len(corners_m)
    faces = np.arange(3 * count, dtype=np.int32).reshape(count, 3)
    return _skinned(corners_m.reshape(-1, 3), faces, uv_m, skin)


def quads(corners_m: np.ndarray, uv_m: np.ndarray, skin: Skin) -> Mesh:
    """Return two triangles for each of (Q, 4, 3) corners; a quad may collapse to a triangle."""
    faces = _SPLIT + 4 * np.arange(len(corners_m), dtype=np.int32)[:, None, None]
    return _skinned(corners_m.reshape(-1, 3), faces.reshape(-1, 3), uv_m[:, _SPLIT].reshape(-1, 3, 2), skin)


_SPLIT = np.array([[0, 1, 2], [0, 2, 3]], np.int32)


def _skinned(vertices_m: np.ndarray, faces: np.ndarray, uv_m: np.ndarray, skin: Skin) -> Mesh:
    """Return all faces but slivers in one skin."""
    a, b, c = vertices_m[faces].transpose(1, 2, 0)
    p, q = b - a, c - a
    twice = (p[1] * q[2] - p[2] * q[1]) ** 2 + (p[2] * q[0] - p[0] * q[2]) ** 2 + (p[0] * q[1] - p[1] * q[0]) ** 2
    keep = twice > (2 * _MIN_AREA_M2) ** 2
    if not keep.all():
        faces, uv_m = faces[keep], uv_m[keep]
    return _uniform(vertices_m.astype(np.float32), faces, uv_m.astype(np.float32), skin)


def _uniform(vertices_m: np.ndarray, faces: np.ndarray, uv_m: np.ndarray, skin: Skin) -> Mesh:
    count = len(faces)
    color = np.empty((count, 3), np.uint8)
    color[:] = skin.color
    return Mesh(
        vertices_m,
        faces,
        uv_m,
        np.full(count, skin.label, np.uint8),
        np.full(count, skin.material, np.uint8),
        color,
        instance=np.full(count, -1, np.int32),
    )


_BOX_SIGNS = np.array([[x, y, z] for z in (-0.5, 0.5) for y in (-0.5, 0.5) for x in (-0.5, 0.5)])
_BOX_FACES = np.array([[0, 1, 5, 4], [1, 3, 7, 5], [3, 2, 6, 7], [2, 0, 4, 6], [4, 5, 7, 6], [2, 3, 1, 0]])[:, _SPLIT]
_BOX_FACES = _BOX_FACES.reshape(12, 3).astype(np.int32)
_BOX_AXES = np.repeat([[0, 2], [1, 2], [0, 2], [1, 2], [0, 1], [0, 1]], 2, axis=0)


def box(size_m: Triple, center_m: Triple, skin: Skin, top: Skin | None = None) -> Mesh:
    """Build a cuboid; `top` is the skin of its upper face.

    Side faces have u along the wall and v = height above the frame's z = 0.
    """
    mesh = panel(size_m, center_m, skin, "frbltd")
    if top is not None:
        mesh.label[8:10], mesh.material[8:10], mesh.color[8:10] = top
    return mesh


def panel(size_m: Triple, center_m: Triple, skin: Skin, sides: str) -> Mesh:
    """Build some sides of a cuboid: 'f' (-y), 'r' (+x), 'b' (+y), 'l' (-x), 't' (+z) and 'd' (-z)."""
    kept = [2 * "frbltd".index(side) + k for side in sides for k in (0, 1)]
    corners = (_BOX_SIGNS * size_m + center_m).astype(np.float32)
    faces = _BOX_FACES[kept]
    return _uniform(corners, faces, corners[faces[:, :, None], _BOX_AXES[kept][:, None]], skin)


def sheet(points_m: np.ndarray, uv_m: np.ndarray, skin: Skin) -> Mesh:
    """Build quads between neighbours of a net of (rows, columns, 3) points.

    The outer side is the one from which columns run to the right and rows upwards.
    """

    def cells(net: np.ndarray) -> np.ndarray:
        return np.stack([net[:-1, :-1], net[:-1, 1:], net[1:, 1:], net[1:, :-1]], 2).reshape(-1, 4, net.shape[-1])

    return quads(cells(points_m), cells(uv_m), skin)


def lathe(
    radius_m: Sequence[Number],
    height_m: Sequence[Number],
    sides: int,
    skin: Skin,
    center_m: tuple[Number, Number] = (0.0, 0.0),
) -> Mesh:
    """Turn a profile, given from bottom to top, around a vertical axis; a radius of 0 closes an end."""
    angle = np.linspace(0, 2 * np.pi, sides + 1)
    radius, height = np.asarray(radius_m, float)[:, None], np.asarray(height_m, float)[:, None]
    x, y = center_m[0] + radius * np.cos(angle), center_m[1] + radius * np.sin(angle)
    ring = np.stack([x, y, np.broadcast_to(height, x.shape)], -1)
    steps = np.hypot(np.diff(radius[:, 0]), np.diff(height[:, 0]))
    length = height[0] + np.concatenate([[0], np.cumsum(steps)])
    uv = np.stack(np.meshgrid(angle * radius.max(), length), -1)
    return sheet(ring, uv, skin)


def beam(start_m: Triple, end_m: Triple, radius_m: Number, skin: Skin) -> Mesh:
    """Build a four-sided bar between two points, open at its ends."""
    start, end = np.asarray(start_m, float), np.asarray(end_m, float)
    length_m = float(np.sqrt(((end - start) ** 2).sum()))
    axis = (end - start) / length_m
    helper = np.array([0.0, 0, 1]) if abs(axis[2]) < 0.9 else np.array([1.0, 0, 0])
    right = _cross(axis, helper)
    right /= np.sqrt(right @ right)
    up = _cross(axis, right)
    angle = np.pi / 4 + np.pi / 2 * np.arange(5)
    around = radius_m * (np.cos(angle)[:, None] * right + np.sin(angle)[:, None] * up)
    net = np.stack([start + around, end + around])
    uv = np.zeros((2, 5, 2))
    uv[..., 0], uv[1, :, 1] = radius_m * 1.4 * np.arange(5), length_m
    return sheet(net, uv, skin)


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the cross product of two vectors (3,), many times faster than `np.cross` for single ones."""
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def fan(rim_m: np.ndarray, skin: Skin, uv_axes: tuple[int, int] = (0, 1)) -> Mesh:
    """Build a face over a closed counter-clockwise (P, 3) rim from its mean point; `uv_axes` of the points give uv."""
    corners = np.stack([np.broadcast_to(rim_m.mean(0), rim_m.shape), rim_m, np.roll(rim_m, -1, 0)], 1)
    return triangles(corners, corners[..., uv_axes], skin)


def blob(
    rng: np.random.Generator,
    radius_m: Triple,
    center_m: Triple,
    skin: Skin,
    roughness: Number = 0.18,
    sides: int = 7,
    rows: int = 5,
) -> Mesh:
    """Build a lumpy ellipsoid, for crowns, bushes and heads; `roughness` is noise as a fraction of the radius."""
    polar, angle = np.linspace(-np.pi / 2, np.pi / 2, rows)[:, None], np.linspace(0, 2 * np.pi, sides + 1)[None]
    scale = 1 + roughness * rng.uniform(-1, 1, (rows, sides + 1))
    scale[:, -1] = scale[:, 0]
    scale[[0, -1]] = 1
    twist = angle + np.pi / sides * (np.arange(rows)[:, None] % 2)
    x, y, z = np.cos(polar) * np.cos(twist), np.cos(polar) * np.sin(twist), np.sin(polar)
    unit = np.stack(np.broadcast_arrays(x, y, z), -1)
    points = unit * scale[..., None] * radius_m + center_m
    uv = np.stack(np.broadcast_arrays(angle * radius_m[0], polar * radius_m[2]), -1)
    return sheet(points, uv, skin)


def loft(profile_m: np.ndarray, half_width_m: np.ndarray, across: list[Skin], side: Skin) -> Mesh:
    """Build a body between two mirrored side outlines.

    `profile_m` is the (P, 2) counter-clockwise outline in (x, z), seen from -y (the body's right side), `half_width_m`
    (P,) the half width along y at its points, `across` the skin of the strip after each point, `side` that of both
    sides.
    """
    x, z = profile_m.T
    right, left = np.stack([x, -half_width_m, z], 1), np.stack([x, half_width_m, z], 1)
    meshes = []
    for i, skin in enumerate(across):
        j = (i + 1) % len(across)
        length = float(np.hypot(*(profile_m[j] - profile_m[i])))
        corners = np.stack([right[i], right[j], left[j], left[i]])[None, ::-1]
        a, b = half_width_m[i], half_width_m[j]
        uv = np.array([[a, 0], [b, length], [-b, length], [-a, 0]])
        meshes.append(quads(corners, uv[None, ::-1], skin))
    return concatenate([*meshes, fan(right, side, (0, 2)), fan(left[::-1], side, (0, 2))])


def upright_pose(point_m: np.ndarray, yaw_rad: Number) -> np.ndarray:
    """Return the (4, 4) pose of an upright thing at a point (3,)."""
    return upright(point_m[None], np.array([yaw_rad]), np.ones((1, 3)))[0]


def upright(position_m: np.ndarray, yaw_rad: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """Return (K, 4, 4) poses at (K, 3) positions, turned by yaw (K,) and stretched by scale (K, 3)."""
    cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
    pose = np.zeros((len(position_m), 4, 4))
    pose[:, 0, 0], pose[:, 0, 1] = scale[:, 0] * cos, -scale[:, 1] * sin
    pose[:, 1, 0], pose[:, 1, 1] = scale[:, 0] * sin, scale[:, 1] * cos
    pose[:, 2, 2], pose[:, 3, 3] = scale[:, 2], 1
    pose[:, :3, 3] = position_m
    return pose
