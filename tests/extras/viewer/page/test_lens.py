"""Directions between a table's entries are those of the lens models."""

import numpy as np
import pytest
import torch

from omniocc.camera import Rig
from omniocc.extras.viewer.page.lens import UNIT, direction_table, interpolate

RIGS = ("fisheye6", "pinhole6", "surround_view")


@pytest.mark.parametrize("size", [(160, 90), (512, 288)])
@pytest.mark.parametrize("name", RIGS)
def test_every_pixel_has_the_direction_of_the_rig(name, size):
    rig = Rig.load(name).resized(*size)
    for camera in (0, len(rig.cameras) - 1):
        table = direction_table(rig, camera)
        exact, valid = (part.numpy() for part in rig.rays(camera))
        assert np.array_equal(table.valid, valid)
        v, u = np.nonzero(valid)
        found = interpolate(table.directions, table.step, u, v)
        angle = np.degrees(2 * np.arcsin(np.linalg.norm(found - exact[v, u], axis=1) / 2))
        assert angle.max() < 0.1
        assert table.directions.size < valid.size * 3 / table.step**2 * 1.5 + 1000


def test_directions_between_pixels_are_interpolated_too():
    rig = Rig.load("fisheye6").resized(160, 90)
    table = direction_table(rig, 0)
    random = np.random.default_rng(0)
    pixels = torch.from_numpy(random.uniform([40, 20], [120, 70], (200, 2)))
    rays, valid = rig.cameras[0].unproject(pixels)
    assert valid.all()
    exact = (rays @ rig.ego_from_camera[0, :3, :3].T).numpy()
    found = interpolate(table.directions, table.step, *pixels.numpy().T)
    assert np.degrees(np.linalg.norm(found - exact, axis=1)).max() < 0.1


def test_a_table_holds_unit_directions_in_the_ego_frame():
    rig = Rig.load("pinhole6").resized(64, 36)
    table = direction_table(rig, 0)
    assert np.abs(np.linalg.norm(table.directions.astype(float), axis=-1) / UNIT - 1).max() < 1e-4
    forward = rig.ego_from_camera[0, :3, 2].numpy()
    middle = interpolate(table.directions, table.step, np.array([31.5]), np.array([17.5]))[0]
    assert middle @ forward > 0.999
