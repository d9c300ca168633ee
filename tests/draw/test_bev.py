import math

import numpy as np
import pytest
import torch

from omniocc.classes import WORLD_CLASSES
from omniocc.draw import bev, error_bev
from omniocc.draw.bev import EMPTY, HALLUCINATED, MISSED, OUTSIDE, RIGHT, SHIFTED, WRONG
from omniocc.draw.canvas import INK
from omniocc.geometry import Cuboid, Cylinder

CYLINDER = Cylinder(shape=(7, 9, 3), radius_m=(1.0, 20.0), height_m=(-2.8, 3.6))
CUBOID = Cuboid(shape=(6, 4, 3), x_m=(-8.0, 16.0), y_m=(-10.0, 12.0), height_m=(-2.8, 3.6))


def column_of(geometry, x, y):
    if geometry is CYLINDER:
        ring = math.floor((math.hypot(x, y) - 1) / 19 * 7)
        sector = math.floor((math.atan2(y, x) + math.pi) / (2 * math.pi) * 9) % 9
        return (ring, sector) if 0 <= ring < 7 else None
    i, j = math.floor((x + 8) / 24 * 6), math.floor((y + 10) / 22 * 4)
    return (i, j) if 0 <= i < 6 and 0 <= j < 4 else None


@pytest.mark.parametrize(("geometry", "half_m"), [(CYLINDER, 20.0), (CUBOID, 16.0)], ids=["cylinder", "cuboid"])
def test_every_pixel_shows_the_column_it_lies_in(geometry, half_m):
    torch.manual_seed(0)
    labels = torch.tensor([0, 0, 1, 7, 255], dtype=torch.uint8)[torch.randint(0, 5, geometry.shape)]
    size = 61
    image = bev(labels, geometry, WORLD_CLASSES, size)
    assert image.shape == (size, size, 3)
    for row in range(size):
        for column in range(size):
            x = half_m - (row + 0.5) * 2 * half_m / size
            y = half_m - (column + 0.5) * 2 * half_m / size
            if math.hypot(x, y) < 4:
                continue  # the ego car is drawn here
            cell = column_of(geometry, x, y)
            if cell is None:
                expected = OUTSIDE
            else:
                known = [c for c in labels[cell].tolist() if c not in (0, 255)]
                expected = WORLD_CLASSES.palette[known[-1]] if known else EMPTY
            assert tuple(image[row, column]) == tuple(expected), (x, y)


def test_the_bar_of_a_map_is_as_long_as_its_text_says():
    """A map of 32 m on 320 px: 80 px of room hold 5 m, 50 px."""
    empty = torch.zeros((4, 4, 2), dtype=torch.uint8)
    image = bev(empty, Cuboid((4, 4, 2), (-16.0, 16.0), (-16.0, 16.0), (-2.0, 2.0)), WORLD_CLASSES, 320)
    assert ((image[302] == INK).all(1)).sum() == 50


def test_forward_is_up_and_left_is_left():
    geometry = Cuboid(shape=(16, 16, 4), x_m=(-16, 16), y_m=(-16, 16), height_m=(-2, 2))
    labels = torch.zeros(geometry.shape, dtype=torch.uint8)
    index, _ = geometry.index(torch.tensor([12.5, 7.5, 0.0]))
    labels[tuple(index.tolist())] = 10
    rows, columns = np.nonzero((bev(labels, geometry, WORLD_CLASSES, 64) == WORLD_CLASSES.palette[10]).all(2))
    assert rows.max() < 32 * (1 - 12 / 16) + 1
    assert columns.max() < 32 * (1 - 6 / 16) + 1


def test_differences():
    geometry = Cuboid(shape=(1, 11, 3), x_m=(-44, 44), y_m=(-44, 44), height_m=(-2, 2))
    cases = [
        ([1, 1, 1], [1, 1, 1], RIGHT),
        ([1, 1, 0], [2, 2, 0], WRONG),
        ([1, 1, 1], [1, 0, 0], MISSED),
        ([0, 0, 0], [0, 4, 0], HALLUCINATED),
        ([0, 0, 0], [0, 0, 0], EMPTY),
        ([255, 255, 1], [4, 4, 1], RIGHT),
        ([1, 2, 0], [1, 1, 0], RIGHT),  # as much right as wrong
        ([0, 1, 0], [0, 0, 1], SHIFTED),
        ([0, 1, 0], [0, 0, 2], MISSED),  # another class at another height
        ([1, 0, 0], [0, 1, 1], HALLUCINATED),
        ([1, 1, 0], [0, 1, 1], RIGHT),
    ]
    truth, prediction = (torch.tensor([case[part] for case in cases]) for part in (0, 1))
    expected = [case[2] for case in cases]
    image = error_bev(truth[None].to(torch.uint8), prediction[None].to(torch.uint8), geometry, 110)
    for column, color in enumerate(expected):
        assert tuple(image[2, 105 - 10 * column]) == color, column
