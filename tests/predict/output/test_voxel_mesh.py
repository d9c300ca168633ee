import math

import numpy as np
import pytest
import torch

from omniocc.classes import WORLD_CLASSES
from omniocc.geometry import Cuboid, Cylinder
from omniocc.predict.output.ply import ply_bytes
from omniocc.predict.output.voxel_mesh import voxel_mesh

CUBOID = Cuboid((4, 3, 2), (0.0, 8.0), (-3.0, 3.0), (-1.0, 1.0))  # cells of 2 x 2 x 1 m
CYLINDER = Cylinder((3, 90, 2), (0.0, 3.0), (-1.0, 1.0))


def volume_m3(mesh):
    """By the divergence theorem: only right for a closed surface whose triangles all face outwards."""
    a, b, c = mesh.points_m[mesh.triangles].transpose(1, 0, 2)
    return float((a * np.cross(b, c)).sum() / 6)


def area_m2(mesh):
    a, b, c = mesh.points_m[mesh.triangles].transpose(1, 0, 2)
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)


def test_one_box():
    labels = torch.zeros(CUBOID.shape, dtype=torch.uint8)
    labels[1, 2, 0] = 7
    labels[3, 0, 1] = 255  # unknown is not drawn
    mesh = voxel_mesh(labels, CUBOID, WORLD_CLASSES)
    assert len(mesh.triangles) == 12
    assert mesh.points_m.min(0).tolist() == [2.0, 1.0, -1.0]
    assert mesh.points_m.max(0).tolist() == [4.0, 3.0, 0.0]
    assert volume_m3(mesh) == pytest.approx(4.0)
    assert {tuple(color) for color in mesh.colors.tolist()} == {tuple(WORLD_CLASSES.palette[7].tolist())}


def test_faces_between_occupied_cells_are_left_out():
    labels = torch.zeros(CUBOID.shape, dtype=torch.uint8)
    labels[0:2, 0, 0] = torch.tensor([1, 4], dtype=torch.uint8)
    mesh = voxel_mesh(labels, CUBOID, WORLD_CLASSES)
    assert volume_m3(mesh) == pytest.approx(8.0)
    assert area_m2(mesh) == pytest.approx(2 * (4 * 2 + 4 * 1 + 2 * 1))
    assert len(mesh.triangles) == 20


def test_a_full_cylinder_is_a_prism_without_inner_faces():
    labels = torch.full(CYLINDER.shape, 4, dtype=torch.uint8)
    mesh = voxel_mesh(labels, CYLINDER, WORLD_CLASSES)
    base = 90 / 2 * 9 * math.sin(2 * math.pi / 90)
    assert volume_m3(mesh) == pytest.approx(2 * base)
    assert area_m2(mesh) == pytest.approx(2 * base + 2 * 90 * 2 * 3 * math.sin(math.pi / 90))
    # 90 sectors: 3 rings above and below, 2 levels at the rim; none at the axis, none where the angle wraps around
    assert len(mesh.triangles) == 2 * 90 * (3 + 3 + 2)


def test_cells_on_both_sides_of_the_seam_touch():
    labels = torch.zeros(CYLINDER.shape, dtype=torch.uint8)
    labels[2, [0, 89], 0] = 4
    assert len(voxel_mesh(labels, CYLINDER, WORLD_CLASSES).triangles) == 2 * 10


def test_nothing_gives_an_empty_mesh_that_can_be_written():
    mesh = voxel_mesh(torch.zeros(CUBOID.shape, dtype=torch.uint8), CUBOID, WORLD_CLASSES)
    assert b"element vertex 0" in ply_bytes(*mesh)


def test_a_mesh_file_read_back():
    points, colors = np.arange(9.0).reshape(3, 3), np.arange(9, dtype=np.uint8).reshape(3, 3) + 200
    header, _, body = ply_bytes(points, colors, np.array([[2, 0, 1]])).partition(b"end_header\n")
    lines = header.decode().splitlines()
    assert lines[:2] == ["ply", "format binary_little_endian 1.0"]
    assert lines[-2:] == ["element face 1", "property list uchar int vertex_indices"]
    assert "element vertex 3" in lines
    assert np.frombuffer(body[:15], "<f4", 3).tolist() == [0.0, 1.0, 2.0]
    assert list(body[12:15]) == [200, 201, 202]
    assert body[45] == 3
    assert np.frombuffer(body[46:], "<i4").tolist() == [2, 0, 1]
