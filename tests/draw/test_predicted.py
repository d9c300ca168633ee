import numpy as np
import pytest
import torch

from omniocc.camera import Equirectangular, Rig
from omniocc.draw import predicted_sheet
from omniocc.draw.predicted import from_above

PANORAMA = Equirectangular(24, 6, 45.0, -45.0)


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
        assert predicted_sheet(images, rig, PANORAMA, ranges, colors, "x", width_px=900).shape[1:] == (900, 3)
