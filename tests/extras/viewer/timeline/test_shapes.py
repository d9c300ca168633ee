"""Differences, rays and outlines, compared with plain loops and with the metric."""

import numpy as np
import pytest
import torch

from omniocc.camera import Rig
from omniocc.classes import WORLD_CLASSES
from omniocc.extras.viewer.timeline.shapes import (
    OUTLINE_M,
    camera_outline,
    class_meshes,
    difference_cells,
    difference_meshes,
    ray_outcomes,
    shade_faces,
)
from omniocc.geometry import Cuboid, Cylinder
from omniocc.metric import RayIoU, sparseocc_directions

GRIDS = (
    Cylinder((12, 16, 4), (0.0, 12.0), (-2.8, 3.6)),
    Cuboid((12, 14, 4), (-12.0, 12.0), (-14.0, 14.0), (-2.8, 3.6)),
)


def labels_of(grid, seed, unknown=0.0):
    generator = torch.Generator().manual_seed(seed)
    labels = torch.randint(1, 5, grid.shape, generator=generator, dtype=torch.uint8)
    labels[torch.rand(grid.shape, generator=generator) < 0.85] = 0
    labels[torch.rand(grid.shape, generator=generator) < unknown] = 255
    return labels


@pytest.mark.parametrize("grid", GRIDS)
def test_differences_are_those_of_a_plain_loop(grid):
    truth, prediction = labels_of(grid, 0, 0.1), labels_of(grid, 1)
    found = difference_cells(truth, prediction)
    for place in np.ndindex(grid.shape):
        true, predicted = int(truth[place]), int(prediction[place])
        kind = None
        if true == 255 or true == predicted:
            kind = None
        elif predicted == 0:
            kind = "missed"
        elif true == 0:
            kind = "hallucinated"
        else:
            kind = "wrong class"
        assert [name for name, cells in found.items() if cells[place]] == ([kind] if kind else [])
    assert all(cells.any() for cells in found.values())
    assert set(difference_meshes(truth, prediction, grid)) == set(found)
    assert difference_meshes(truth, truth.where(truth != 255, 0), grid) == {}


@pytest.mark.parametrize("grid", GRIDS)
def test_rays_are_counted_as_by_the_metric(grid):
    truth, prediction = labels_of(grid, 2, 0.02), labels_of(grid, 2)
    prediction[4:7] = labels_of(grid, 3)[4:7]
    outcomes = ray_outcomes(truth, prediction, grid, WORLD_CLASSES, sparseocc_directions())
    metric = RayIoU(grid, thresholds_m=(2.0,))
    metric.update(prediction[None], truth[None])
    assert len(outcomes.hits_m) == int(metric.correct.sum()) > 100
    assert len(outcomes.hits_m) + len(outcomes.misses_m) == int(metric.truth.sum())
    assert len(outcomes.misses_m) > 100
    ends = outcomes.misses_m / np.linalg.norm(outcomes.misses_m, axis=-1, keepdims=True)
    assert np.allclose(ends[:, 0], ends[:, 1], atol=1e-6)  # both ends lie on the same ray


def test_a_lone_voxel_has_six_faces_and_two_have_ten():
    grid = Cuboid((3, 3, 3), (0.0, 3.0), (0.0, 3.0), (0.0, 3.0))
    labels = torch.zeros(grid.shape, dtype=torch.uint8)
    labels[1, 1, 1] = 4
    (mesh,) = class_meshes(labels, grid, WORLD_CLASSES).values()
    assert len(mesh.triangles) == 12
    labels[1, 1, 2] = 7
    meshes = class_meshes(labels, grid, WORLD_CLASSES)
    assert {name: len(mesh.triangles) for name, mesh in meshes.items()} == {"Building": 10, "Vehicle": 10}
    corners = meshes["Building"].points_m[meshes["Building"].triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    outward = corners.mean(1) - np.array([1.5, 1.5, 1.5])
    assert ((normals * outward).sum(1) > 0).all()


def test_faces_that_look_the_same_way_share_vertices():
    quad = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    mesh = shade_faces(np.stack([quad, quad + np.array([1, 0, 0])]), (100, 100, 100))
    assert len(mesh.points_m) == 6
    assert len(mesh.triangles) == 4
    edge = shade_faces(np.stack([quad, quad[:, [0, 2, 1]][::-1]]), (100, 100, 100))
    assert len(edge.points_m) == 8  # another brightness


@pytest.mark.parametrize("name", ["fisheye6", "pinhole6", "surround_view"])
def test_outlines_are_the_border_of_what_a_camera_sees(name):
    rig = Rig.load(name)
    for k, camera in enumerate(rig.cameras):
        border, *corners = camera_outline(rig, k)
        start = rig.ego_from_camera[k, :3, 3].numpy()
        assert np.allclose(np.linalg.norm(border - start, axis=1), OUTLINE_M)
        assert np.array_equal(border[0], border[-1])
        assert all(np.array_equal(line[0], start) for line in corners)
        camera_from_ego = torch.linalg.inv(rig.ego_from_camera[k])
        rays = torch.from_numpy(border - start) @ camera_from_ego[:3, :3].T
        pixels, valid = camera.project(rays)
        assert valid.all()
        middle = torch.tensor([(camera.width - 1) / 2, (camera.height - 1) / 2], dtype=torch.float64)
        beyond = middle + (pixels - middle) * 1.04
        inside = (beyond >= -0.5).all(1) & (beyond[:, 0] <= camera.width - 0.5) & (beyond[:, 1] <= camera.height - 0.5)
        assert not (camera.unproject(beyond)[1] & inside).any()  # a little farther out nothing is seen
