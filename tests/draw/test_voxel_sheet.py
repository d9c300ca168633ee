import numpy as np
import pytest
import torch

from omniocc.camera import Equirectangular, Rig
from omniocc.classes import WORLD_CLASSES
from omniocc.draw.voxel_sheet import RangePanorama, camera_order, columns_of, occupancy_sheet
from omniocc.geometry import Cuboid, Cylinder

RANGES = RangePanorama(Equirectangular(24, 6, 45.0, -45.0), torch.rand(6, 24) * 9 + 1)


@pytest.mark.parametrize(
    ("rig", "expected"),
    [
        ("fisheye6", ["front_left", "front", "front_right", "rear_left", "rear", "rear_right"]),
        ("surround_view", ["left", "front", "right", "back"]),
    ],
)
def test_cameras_are_ordered_by_direction(rig, expected):
    rig = Rig.load(rig)
    assert [rig.names[k] for k in camera_order(rig)] == expected


def test_columns():
    assert [columns_of(count) for count in (1, 2, 3, 4, 5, 6, 8)] == [1, 2, 3, 4, 3, 3, 4]


@pytest.mark.parametrize(
    ("name", "geometry"),
    [
        ("fisheye6", Cylinder((8, 12, 4), (0.0, 16.0), (-2.8, 3.6))),
        ("surround_view", Cuboid((8, 8, 4), (-10.0, 10.0), (-10.0, 10.0), (-2.8, 3.6))),
    ],
)
def test_sheets_of_any_rig_with_and_without_truth_and_ranges(name, geometry):
    rig = Rig.load(name).resized(64, 36)
    images = [np.full((36, 64, 3), 80, np.uint8)] * len(rig.names)
    labels = torch.randint(0, 12, geometry.shape, dtype=torch.uint8)
    heights = []
    for ranges, truth in (
        (None, None),
        (RANGES, None),
        (RANGES, labels.roll(1, 0)),
        (None, torch.full_like(labels, 255)),
    ):
        sheet = occupancy_sheet(images, rig, labels, geometry, WORLD_CLASSES, ranges, truth, "x", width_px=700)
        assert sheet.shape[1:] == (700, 3)
        heights.append(len(sheet))
    assert heights[0] < heights[1] < heights[2]
