import numpy as np
import torch

from omniocc.camera import Equirectangular
from omniocc.classes import WORLD_CLASSES
from omniocc.draw import sketch_sheet
from omniocc.draw.bev import EMPTY, MISSED
from omniocc.draw.ranges import range_colors
from omniocc.draw.sketch import HIT, SUPERFLUOUS, candidate_bev, points_bev, scores
from omniocc.geometry import Cuboid, Cylinder


def test_columns_have_the_colour_of_their_most_frequent_kind():
    geometry = Cuboid(shape=(1, 6, 3), x_m=(-24, 24), y_m=(-24, 24), height_m=(-2, 2))
    truth = torch.tensor([[1, 4, 0], [0, 0, 0], [1, 1, 0], [0, 0, 0], [255, 255, 3], [2, 0, 0]])[None].to(torch.uint8)
    candidates = torch.tensor([[1, 1, 1], [0, 1, 0], [1, 0, 0], [0, 0, 0], [1, 1, 1], [0, 1, 0]])[None].bool()
    expected = [HIT, SUPERFLUOUS, MISSED, EMPTY, HIT, MISSED]
    image = candidate_bev(truth, candidates, geometry, 60)
    for column, color in enumerate(expected):
        assert tuple(image[2, 55 - 10 * column]) == color, column
    assert scores(truth, candidates) == "recall 0.67, precision 0.57, fraction 0.50"


def test_points_lie_in_their_column_in_the_colour_of_their_range():
    geometry = Cuboid(shape=(16, 16, 4), x_m=(-16, 16), y_m=(-16, 16), height_m=(-2, 2))
    panorama = Equirectangular(8, 2, 10.0, -10.0)  # columns at 157.5, 112.5, 67.5, 22.5 ... degrees, rows at +-5
    ranges = torch.full((2, 8), torch.nan)
    ranges[1, 2] = 12.0  # ahead by 4.6 m and left by 11 m
    image = points_bev(ranges, panorama, geometry, 160)
    rows, columns = np.nonzero((image == range_colors(np.array([12.0]))[0]).all(2))
    assert (rows.min(), rows.max()) == (50, 59)  # x from 4 to 6 m
    assert (columns.min(), columns.max()) == (20, 29)  # y from 10 to 12 m


def test_a_sheet_of_any_grid():
    for geometry in (Cylinder(shape=(6, 10, 4)), Cuboid(shape=(6, 8, 4))):
        truth = torch.randint(0, 12, geometry.shape, dtype=torch.uint8)
        mask = torch.rand(geometry.shape) < 0.3
        ranges = torch.rand(4, 16) * 20 + 1
        ranges[0] = torch.nan
        images = [np.full((36, 64, 3), 9, np.uint8)] * 6
        panorama = Equirectangular(16, 4, 45.0, -45.0)
        image = sketch_sheet(
            images, truth, mask, mask | (truth == 1), geometry, WORLD_CLASSES, panorama, ranges, "x", 800
        )
        assert image.shape[1:] == (800, 3)
