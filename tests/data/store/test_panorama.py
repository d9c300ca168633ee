"""Recorded panoramas at other sizes."""

import numpy as np
import torch

from omniocc.camera import Equirectangular
from omniocc.data.formats.projected import onto_panorama
from omniocc.data.store.panorama import resampled

FINE, COARSE = Equirectangular(720, 180, 45.0, -45.0), Equirectangular(192, 48, 45.0, -45.0)


def ranges_of(panorama: Equirectangular) -> np.ndarray:
    """Return the ranges of a box of 20 x 12 x 8 m around the origin, exactly."""
    rays = panorama.rays()
    return (torch.tensor([10.0, 6.0, 4.0]) / rays.abs()).amin(dim=-1).numpy()


def test_ranges_are_those_of_the_same_directions():
    for given, wanted in ((FINE, COARSE), (COARSE, FINE)):
        found, true = resampled(ranges_of(given), given, wanted), ranges_of(wanted)
        assert found.shape == (wanted.height, wanted.width)
        step = np.radians(90 / min(given.height, wanted.height))
        assert np.median(np.abs(found / true - 1)) < step
        assert np.abs(found / true - 1).max() < 6 * step  # where a wall is seen at its flattest
    assert resampled(ranges_of(FINE), FINE, FINE) is not None


def test_beyond_the_recorded_edges_nothing_is_known():
    narrow = Equirectangular(720, 120, 15.0, -45.0)
    found = resampled(ranges_of(narrow), narrow, COARSE)
    assert np.isnan(found[:16]).all()  # 45 to 15 degrees: 30 of 90 degrees, 16 of 48 rows
    assert np.isfinite(found[16:]).all()


def test_no_point_of_a_lidar_is_lost():
    directions = np.random.default_rng(0).normal(size=(300, 3)) * (1, 1, 0.3)
    points = 8 * directions / np.linalg.norm(directions, axis=1, keepdims=True)
    found = resampled(onto_panorama(points, None, FINE).range_m, FINE, COARSE)
    direct = onto_panorama(points, None, COARSE).range_m
    near = torch.from_numpy(np.isfinite(found)).float()[None, None]
    near = torch.nn.functional.max_pool2d(near, 3, 1, padding=1)[0, 0].numpy()  # a fine pixel may lie in the next cell
    assert near[:, 1:-1][np.isfinite(direct)[:, 1:-1]].all()
    assert abs(np.isfinite(found).sum() / np.isfinite(direct).sum() - 1) < 0.03
    assert np.allclose(found[np.isfinite(found)], 8)
