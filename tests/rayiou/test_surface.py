"""Faces between occupied cells and the rest."""

import numpy as np
import pytest
import torch

from omniocc.geometry import Cuboid, Cylinder
from rayiou.surface import extract_surface

CUBOID = Cuboid((4, 3, 2), (0.0, 8.0), (-3.0, 3.0), (-1.0, 1.0))
CYLINDER = Cylinder((3, 90, 2), (1.0, 4.0), (-1.0, 1.0))


@pytest.mark.parametrize("geometry", [CUBOID, CYLINDER], ids=["cuboid", "cylinder"])
def test_corners_turn_counter_clockwise_seen_from_outside(geometry):
    occupied = torch.rand(geometry.shape, generator=torch.Generator().manual_seed(0)) < 0.4
    corners, cells = extract_surface(occupied, geometry)
    normals = np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])
    outwards = corners.mean(1) - geometry.centers(torch.float64).reshape(-1, 3).numpy()[cells]
    assert ((normals * outwards).sum(1) > 0).all()


def test_one_face_for_each_neighbour_that_is_free_or_outside():
    occupied = torch.zeros(CUBOID.shape, dtype=torch.bool)
    occupied[0, 0, 0] = occupied[1, 0, 0] = True
    _, cells = extract_surface(occupied, CUBOID)
    assert np.bincount(cells).tolist() == [5, 0, 0, 0, 0, 0, 5]


def test_no_face_where_the_angle_wraps_around():
    occupied = torch.zeros(CYLINDER.shape, dtype=torch.bool)
    occupied[1, [0, 89], 0] = True
    assert len(extract_surface(occupied, CYLINDER).cells) == 10
    assert len(extract_surface(torch.ones_like(occupied), CYLINDER).cells) == 90 * (2 * 3 + 2 * 2)
