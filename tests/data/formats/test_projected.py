import numpy as np
import pytest
import torch

from omniocc.camera import Equirectangular, Rig
from omniocc.data.formats.projected import nearest, onto_cameras, onto_panorama


def test_the_nearest_point_of_a_pixel_is_kept():
    pixels = torch.tensor([[1.2, 0.4], [0.8, -0.4], [1.0, 0.0], [3.4, 1.4]])
    labels = torch.tensor([1, 2, 3, 4], dtype=torch.uint8)
    found = nearest(pixels, torch.tensor([5.0, 3.0, 4.0, 9.0]), labels, (2, 4))
    expected = np.full((2, 4), np.nan, np.float32)
    expected[0, 1], expected[1, 3] = 3.0, 9.0
    np.testing.assert_array_equal(found.range_m, expected)
    assert found.labels.tolist() == [[255, 2, 255, 255], [255, 255, 255, 4]]


def test_points_along_the_rays_of_pixels_come_back_to_them():
    rig = Rig.load("fisheye6").resized(64, 36)
    rng = np.random.default_rng(0)
    for camera in (0, 3):
        rays, valid = rig.rays(camera)
        rows, columns = np.nonzero(valid.numpy())
        chosen = rng.choice(len(rows), 50, replace=False)
        range_m = rng.uniform(3, 40, 50)
        center = rig.ego_from_camera[camera, :3, 3].numpy()
        points = center + rays.numpy()[rows[chosen], columns[chosen]] * range_m[:, None]
        found = onto_cameras(points, np.full(50, 7, np.uint8), rig)[camera]
        assert found.range_m[rows[chosen], columns[chosen]] == pytest.approx(range_m, rel=1e-5)
        assert np.isfinite(found.range_m).sum() == 50
        assert set(found.labels[rows[chosen], columns[chosen]]) == {7}


def test_a_panorama_has_ranges_from_the_ego_origin():
    panorama = Equirectangular(36, 9, 45.0, -45.0)
    rays = panorama.rays().numpy()
    points = rays[[1, 4, 7], [0, 18, 35]] * np.array([[4.0], [9.0], [30.0]])
    found = onto_panorama(points, None, panorama)
    assert found.range_m[[1, 4, 7], [0, 18, 35]] == pytest.approx([4.0, 9.0, 30.0], rel=1e-5)
    assert np.isfinite(found.range_m).sum() == 3
    assert (found.labels == 255).all()
    assert np.isnan(onto_panorama(np.zeros((0, 3)), None, panorama).range_m).all()
