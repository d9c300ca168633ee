"""Meshes and simple solids: closed where they should be, facing outwards, stretched and painted as requested."""

import numpy as np
import pytest

from omniworld.mesh.material import Material
from omniworld.mesh.mesh import Mesh, concatenate, empty, instances
from omniworld.mesh.shape import Skin, beam, blob, box, lathe, loft, panel, quads, upright

_STONE = Skin(4, Material.CONCRETE, (100, 110, 120))
_ROOF = Skin(4, Material.ROOF, (1, 2, 3))


def volume(mesh: Mesh) -> float:
    """Return the signed volume by the divergence theorem: positive if the faces of a closed surface face outwards."""
    a, b, c = (mesh.vertices[mesh.faces[:, k]].astype(float) for k in range(3))
    return float((a * np.cross(b, c)).sum() / 6)


def test_box_is_closed_and_painted() -> None:
    mesh = box((2, 3, 4), (10, 20, 30), _STONE, _ROOF)
    np.testing.assert_allclose(volume(mesh), 24, rtol=1e-5)
    np.testing.assert_allclose(mesh.vertices.min(0), [9, 18.5, 28])
    up = mesh.vertices[mesh.faces][:, :, 2].min(1) == 32
    assert up.sum() == 2
    assert (mesh.material[up] == Material.ROOF).all()
    assert (mesh.material[~up] == Material.CONCRETE).all()
    assert (mesh.color[up] == (1, 2, 3)).all()
    front = (mesh.vertices[mesh.faces][:, :, 1] == 18.5).all(1)
    np.testing.assert_allclose(mesh.uv[front][..., 1], mesh.vertices[mesh.faces[front]][..., 2])


@pytest.mark.parametrize(
    ("side", "axis", "value"), [("f", 1, -1.5), ("b", 1, 1.5), ("r", 0, 1), ("l", 0, -1), ("t", 2, 2), ("d", 2, -2)]
)
def test_panel_keeps_the_sides_named(side: str, axis: int, value: float) -> None:
    mesh = panel((2, 3, 4), (0, 0, 0), _STONE, side)
    corners = mesh.vertices[mesh.faces].astype(float)
    assert len(mesh) == 2
    assert (corners[..., axis] == value).all()
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, axis]
    assert (np.sign(normal) == np.sign(value)).all()


def test_turned_and_lofted_bodies_face_outwards() -> None:
    cylinder = lathe([0, 1, 1, 0], [0, 0, 2, 2], 64, _STONE)
    np.testing.assert_allclose(volume(cylinder), 2 * np.pi, rtol=0.01)
    ball = blob(np.random.default_rng(0), (1, 2, 3), (5, 0, 0), _STONE, 0.0, sides=48, rows=48)
    np.testing.assert_allclose(volume(ball), 8 * np.pi, rtol=0.02)
    outline = np.array([[0.0, 0], [4, 0], [4, 1], [0, 1]])
    np.testing.assert_allclose(volume(loft(outline, np.full(4, 0.5), [_STONE] * 4, _STONE)), 4, rtol=1e-5)
    along = beam((0, 0, 0), (0, 0, 3), 0.5, _STONE)
    np.testing.assert_allclose(np.ptp(along.vertices[:, 2]), 3)
    first, second, third = along.vertices[along.faces].transpose(1, 0, 2)
    outward = np.cross(second - first, third - first)
    assert ((outward * along.vertices[along.faces].mean(1))[:, :2].sum(1) > 0).all()


def test_collapsed_quads_lose_a_triangle() -> None:
    corners = np.array([[[0, 0, 0], [1, 0, 0], [1, 1, 0], [1, 1, 0]]], float)
    assert len(quads(corners, corners[..., :2], _STONE)) == 1


def test_copies_are_stretched_turned_and_repainted() -> None:
    mesh = box((2, 1, 1), (0, 0, 0.5), _STONE, _ROOF)
    poses = upright(np.array([[5.0, 0, 0], [0, 7, 1]]), np.array([0.0, np.pi / 2]), np.array([[2.0, 1, 1], [1, 1, 3]]))
    copies = instances(mesh, poses, {Material.ROOF: np.array([[9, 9, 9], [8, 8, 8]], np.uint8)})
    assert len(copies) == 2 * len(mesh)
    first, second = copies.vertices[:8], copies.vertices[8:]
    np.testing.assert_allclose([first.min(0), first.max(0)], [[3, -0.5, 0], [7, 0.5, 1]], atol=1e-6)
    np.testing.assert_allclose([second.min(0), second.max(0)], [[-0.5, 6, 1], [0.5, 8, 4]], atol=1e-6)
    roof = copies.material == Material.ROOF
    assert copies.color[roof].tolist() == [[9, 9, 9]] * 2 + [[8, 8, 8]] * 2
    assert (copies.color[~roof] == (100, 110, 120)).all()


def test_concatenate_keeps_faces_on_their_vertices() -> None:
    one, two = box((1, 1, 1), (0, 0, 0), _STONE), box((1, 1, 1), (9, 0, 0), _ROOF)
    both = concatenate([one, empty(), two])
    assert (both.vertices[both.faces[:12]][..., 0] < 1).all()
    assert (both.vertices[both.faces[12:]][..., 0] > 8).all()
    assert both.material.tolist() == [Material.CONCRETE] * 12 + [Material.ROOF] * 12
