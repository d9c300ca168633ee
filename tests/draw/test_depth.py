import math

import numpy as np
import pytest
import torch

from omniocc.camera import Equidistant, Equirectangular, Rig
from omniocc.draw import depth_sheet, predicted_sheet
from omniocc.draw.depth import from_above, paint_ranges
from omniocc.draw.ranges import range_colors

SIZE, FOCAL_PX, AHEAD_M = 101, 40.0, 0.5
PANORAMA = Equirectangular(72, 18, 45.0, -45.0)
FORWARD = torch.tensor([[0.0, 0, 1, AHEAD_M], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]], dtype=torch.float64)
RIG = Rig((Equidistant(SIZE, SIZE, FOCAL_PX, (50.0, 50.0), 95.0),), FORWARD[None], ("front",))
BLACK = [np.zeros((SIZE, SIZE, 3), np.uint8)]
VIEW = Equirectangular(24, 6, 45.0, -45.0)


def pixel_of(row, column, range_m):
    """Return the pixel of the equidistant camera in which a point of the panorama appears."""
    azimuth = math.pi - (column + 0.5) * 2 * math.pi / 72
    elevation = math.radians(45 - (row + 0.5) * 5)
    x = range_m * math.cos(elevation) * math.cos(azimuth) - AHEAD_M
    y, z = range_m * math.cos(elevation) * math.sin(azimuth), range_m * math.sin(elevation)
    angle, flat = math.atan2(math.hypot(y, z), x), math.hypot(y, z)
    return round(50 - FOCAL_PX * angle * z / flat), round(50 - FOCAL_PX * angle * y / flat)


def hue(rgb):
    rgb = np.asarray(rgb, dtype=float)
    return rgb / rgb.max()


@pytest.mark.parametrize(("row", "column", "range_m"), [(9, 36, 4.0), (4, 30, 1.5), (15, 42, 20.0), (8, 27, 3.0)])
def test_a_point_is_drawn_where_the_camera_sees_it_in_the_colour_of_its_range(row, column, range_m):
    ranges = torch.full((18, 72), torch.nan)
    ranges[row, column] = range_m
    (image,) = paint_ranges(BLACK, RIG, PANORAMA, ranges, SIZE)
    v, u = pixel_of(row, column, range_m)
    assert np.allclose(hue(image[v, u]), hue(range_colors(np.array([range_m]))[0]), atol=0.06)
    rows, columns = np.nonzero(image.any(2))
    assert abs(rows.mean() - v) <= 1
    assert abs(columns.mean() - u) <= 1
    assert len(rows) < 80


def test_nothing_is_drawn_behind_the_camera():
    ranges = torch.full((18, 72), torch.nan)
    ranges[9, 0] = 5.0
    assert not paint_ranges(BLACK, RIG, PANORAMA, ranges, SIZE)[0].any()


def test_near_points_hide_far_ones_in_any_order():
    for near, far in ((35, 36), (36, 35)):
        ranges = torch.full((18, 72), torch.nan)
        ranges[9, near], ranges[9, far] = 1.2, 40.0
        (image,) = paint_ranges(BLACK, RIG, PANORAMA, ranges, SIZE)
        v, u = pixel_of(9, near, 1.2)
        assert np.allclose(hue(image[v, u]), hue(range_colors(np.array([1.2]))[0]), atol=0.06)


@pytest.mark.parametrize("cameras", [1, 4, 6])
def test_sheets_of_any_rig(cameras):
    rig = Rig(RIG.cameras * cameras, FORWARD.expand(cameras, 4, 4), tuple(f"c{k}" for k in range(cameras)))
    ranges = torch.rand(18, 72) * 30 + 1
    ranges[:4] = torch.nan
    image = depth_sheet(BLACK * cameras, rig, PANORAMA, ranges, ranges.nan_to_num(torch.inf), "x")
    assert image.shape[1:] == (1280, 3)
    nothing = torch.full_like(ranges, torch.nan)
    depth_sheet(BLACK * cameras, rig, PANORAMA, nothing, ranges)


def test_from_above_forward_is_up_left_is_left_and_higher_hides_lower():
    points = np.array([[6.0, 4.0, 0.0], [6.0, 4.0, 1.0], [6.0, 4.0, -1.0], [50.0, 0.0, 0.0]])
    colors = np.array([[1, 1, 1], [200, 0, 0], [2, 2, 2], [3, 3, 3]], np.uint8)
    image = from_above(points, colors, 10.0, 100)
    rows, columns = np.nonzero((image == (200, 0, 0)).all(2))
    assert (rows.min(), rows.max(), columns.min(), columns.max()) == (19, 21, 29, 31)
    assert (image[20, 30] == (200, 0, 0)).all()
    assert not (image < 4).all(2).any()


@pytest.mark.parametrize("name", ["fisheye6", "surround_view"])
def test_sheets_of_any_rig_with_and_without_predictions(name):
    rig = Rig.load(name).resized(64, 36)
    images = [np.full((36, 64, 3), 80, np.uint8)] * len(rig.names)
    for ranges in (torch.rand(6, 24) * 9 + 1, torch.full((6, 24), torch.nan)):
        colors = torch.randint(0, 255, (6, 24, 3), dtype=torch.uint8)
        assert predicted_sheet(images, rig, VIEW, ranges, colors, "x", width_px=900).shape[1:] == (900, 3)
