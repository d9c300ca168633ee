"""Files of predicted voxels carry the class table of their model."""

import math

import numpy as np
import pytest
import torch

from omniocc.classes import WORLD_CLASSES, ClassTable, SemanticClass
from omniocc.errors import UserError
from omniocc.geometry import Cuboid, Cylinder
from omniocc.predict import PredictedFrame
from omniocc.predict.output.range_files import VERTEX, ply_bytes
from omniocc.predict.output.voxel_files import (
    read_labels,
    read_voxels,
    voxel_arrays,
    voxel_mesh,
    write_mesh,
    write_voxels,
)

GRID = Cuboid((4, 3, 2), (0.0, 8.0), (-3.0, 3.0), (-1.0, 1.0))
CLASSES = ClassTable(tuple(SemanticClass(k, f"kind{k}", (k, 2 * k, 255 - k)) for k in range(19)))


def prediction() -> PredictedFrame:
    labels = torch.zeros(GRID.shape, dtype=torch.uint8)
    labels[1, 2, 0] = 18
    probability = torch.rand(2, *GRID.shape).half()
    return PredictedFrame(labels, labels > 0, None, probability, torch.ones(GRID.shape, dtype=torch.bool))


def test_nineteen_classes_have_their_own_names_and_colours(tmp_path):
    write_voxels(tmp_path, voxel_arrays(prediction(), GRID, CLASSES, None))
    arrays = np.load(tmp_path / "voxels.npz")
    assert arrays["class_names"].tolist() == list(CLASSES.names)
    assert arrays["class_colors"].tolist() == [list(row.rgb) for row in CLASSES.rows]
    assert "world_from_ego" not in arrays
    write_mesh(tmp_path, prediction().labels, GRID, CLASSES)
    body = (tmp_path / "voxels.ply").read_bytes().partition(b"end_header\n")[2]
    vertex = np.frombuffer(body, VERTEX, 1)[0]
    assert (vertex["red"], vertex["green"], vertex["blue"]) == (18, 36, 237)


def test_labels_are_read_back_and_other_files_refused(tmp_path):
    write_voxels(tmp_path, voxel_arrays(prediction(), GRID, CLASSES, None))
    assert torch.equal(read_labels(tmp_path, GRID), prediction().labels)
    with pytest.raises(UserError, match=r"voxels\.npz.*grid"):
        read_labels(tmp_path, Cuboid((4, 3, 1), GRID.x_m, GRID.y_m, GRID.height_m))
    (tmp_path / "voxels.npz").write_bytes(b"not an archive")
    with pytest.raises(UserError, match=r"voxels\.npz.*damaged"):
        read_labels(tmp_path, GRID)


@pytest.mark.parametrize("wrong", [-1, 19, 3.5, np.nan])
def test_labels_that_are_no_classes_are_refused(tmp_path, wrong):
    arrays = voxel_arrays(prediction(), GRID, CLASSES, None)
    write_voxels(tmp_path, arrays)
    assert torch.equal(read_voxels(tmp_path / "voxels.npz").labels, prediction().labels)
    labels = arrays["labels"].astype(np.float64)
    labels[0, 0, 0] = wrong
    np.savez(tmp_path / "voxels.npz", **arrays | {"labels": labels})
    with pytest.raises(UserError, match=rf"voxels\.npz is damaged .*its labels hold \[{float(wrong)}\]"):
        read_voxels(tmp_path / "voxels.npz")


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
