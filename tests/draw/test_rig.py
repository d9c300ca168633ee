import numpy as np
import pytest
import torch

from omniocc.camera import Panoramic, Pinhole, Rig
from omniocc.camera.pose import pose_from_angles
from omniocc.draw.rig import (
    ABOVE,
    COUNTS,
    GREY,
    GRID,
    HORIZON,
    SIDE,
    View,
    camera_view,
    count_colors,
    counts,
    draw_line,
    ground_lines,
    ground_map,
    ground_points,
    rig_sheet,
    view_along,
)

PINHOLE = Pinhole(201, 161, (100.0, 100.0), (100.0, 80.0))
ROAD_Z_M = -2.0


def rig_of(camera, pitch=0.0, mask=None):
    pose = pose_from_angles((0.0, 0.0, 0.0), 0.0, pitch, 0.0)
    return Rig((camera,), pose[None], ("front",), None if mask is None else (mask,), ROAD_Z_M)


def like(pixels, rgb):
    """Return where pixels have the hue of a line that is drawn over grey."""
    return (np.abs(pixels.astype(int) - (0.7 * np.array(rgb) + 0.3 * np.array(GREY))) < 12).all(-1)


def test_the_horizon_of_an_upright_pinhole_is_the_row_of_its_centre():
    image = camera_view(rig_of(PINHOLE), 0, None, 201, ROAD_Z_M)
    assert like(image[80, 10:-10], HORIZON).all()
    assert not like(image[:78], HORIZON).any()
    assert not like(image[84:], HORIZON).any()


def test_the_horizon_of_a_pinhole_that_looks_down_is_higher():
    """100 px * tan(20 degrees) = 36.4 px above the centre."""
    image = camera_view(rig_of(PINHOLE, pitch=-20.0), 0, None, 201, ROAD_Z_M)
    rows = np.flatnonzero(like(image[:, 60], HORIZON))
    assert abs(rows.mean() - (80 - 36.4)) < 0.8


def test_a_corner_of_the_grid_is_where_a_pinhole_sees_it():
    """The point (4, 1, -2) is 4 m ahead, 1 m left and 2 m below: column 100 - 25, row 80 + 50."""
    corner = torch.tensor([4.0, 1, -2], dtype=torch.float64)
    through = [line for line, *_ in ground_lines(ROAD_Z_M) if bool(((line - corner).norm(dim=-1) < 1e-9).any())]
    assert len(through) == 2
    image = camera_view(rig_of(PINHOLE), 0, None, 201, ROAD_Z_M)
    assert like(image[130, 75], GRID)
    assert like(image[130, 50], GRID)  # (4, 2, -2)
    assert not like(image[138, 78:81], GRID).any()


def test_the_image_of_a_camera_is_scaled_and_dark_where_it_is_masked():
    mask = torch.ones(161, 201, dtype=torch.bool)
    mask[:, :100] = False
    image = np.full((322, 402, 3), 200, np.uint8)
    drawn = camera_view(rig_of(PINHOLE, mask=mask), 0, image, 402, ROAD_Z_M)
    assert drawn.shape == (322, 402, 3)
    assert drawn[60, 100].tolist() == [70] * 3
    assert drawn[60, 300].tolist() == [200] * 3


def test_a_line_that_leaves_a_panorama_does_not_cross_it():
    canvas = np.zeros((10, 200, 3), np.uint8)
    places = np.array([[2.0, 5], [1, 5], [198, 5], [197, 5]])
    draw_line(canvas, places, np.ones(4, bool), (255, 255, 255), 1)
    assert canvas[5, [1, 198]].all()
    assert not canvas[:, 20:180].any()
    panorama = camera_view(rig_of(Panoramic(360, 90, 30.0, -60.0)), 0, None, 360, ROAD_Z_M)
    assert like(panorama[30, 10:-10], HORIZON).mean() > 0.9


def test_the_ground_is_coloured_by_the_number_of_cameras_that_see_it():
    """Of the ground, a pinhole of 90.6 degrees across sees what is ahead and not too near."""
    rig = rig_of(PINHOLE)
    assert counts(rig, torch.tensor([[9.0, 0, -2], [-9, 0, -2], [1, 0, -2]])).tolist() == [1, 0, 0]
    points = ground_points(ROAD_Z_M, 10.0, 4)
    assert points[0, 0].tolist() == [7.5, 7.5, -2.0]
    drawn = ground_map(rig, ROAD_Z_M, 200)
    assert drawn[10, 100].tolist() == list(COUNTS[1][1])
    assert drawn[190, 100].tolist() == list(COUNTS[0][1])
    assert count_colors(np.array([7])).tolist() == [list(COUNTS[4][1])]


@pytest.mark.parametrize(
    ("look", "place"), [(ABOVE, [[50, 30], [60, 50], [50, 50]]), (SIDE, [[70, 50], [50, 50], [50, 40]])]
)
def test_forward_is_up_from_above_and_right_from_the_side(look, place):
    """Two metres ahead, one metre right, one metre up; ten pixels to a metre."""
    points = torch.tensor([[2.0, 0, 0], [0, -1, 0], [0, 0, 1]], dtype=torch.float64)
    view = View(look, torch.zeros(3, dtype=torch.float64), 5.0, 101)
    assert np.abs(view.places(points) - np.array(place)).max() <= 1


def test_a_sheet_shows_any_number_of_cameras():
    one = rig_sheet(rig_of(PINHOLE), [None], [], "one", 800)
    assert one.shape[1] == 800
    rig = Rig.load("fisheye6")
    six = rig_sheet(rig, [None] * 6, ["a line " * 60], "six", 800)
    assert like(six, HORIZON).sum() > 6 * 200


def test_a_rig_of_kilometres_is_drawn_with_few_lines():
    """Positions in mm by mistake; without wider steps this rig would have billions of lines."""
    rig = rig_of(PINHOLE)
    far = Rig(rig.cameras * 2, torch.stack([rig.ego_from_camera[0], torch.eye(4).double()]), ("a", "b"), None, ROAD_Z_M)
    far.ego_from_camera[1, 0, 3] = 1e9
    assert 0.5 < (view_along(far, ABOVE, 300, ROAD_Z_M) == 255).all(-1).mean() < 0.99
