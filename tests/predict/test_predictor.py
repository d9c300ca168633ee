"""Labels and probabilities of logits, and the cells that cameras see."""

import math

import numpy as np
import torch

from omniocc.camera import Rig
from omniocc.camera.models.pinhole import Pinhole
from omniocc.camera.pose import pose_from_angles
from omniocc.geometry import Cuboid
from omniocc.predict.predictor import seen_cells

GRID = Cuboid((8, 8, 2), (-8.0, 8.0), (-8.0, 8.0), (-2.0, 2.0))


def ahead_of(position_m: tuple[float, float, float], yaw_deg: float) -> Rig:
    """Return one pinhole of 90 degrees in both directions."""
    camera = Pinhole(200, 200, (100.0, 100.0), (99.5, 99.5))
    return Rig((camera,), pose_from_angles(position_m, yaw_deg, 0.0, 0.0)[None], ("only",))


def sees(point: np.ndarray, start: np.ndarray, yaw_rad: float) -> bool:
    """Return whether a point is within 45 degrees of the axis, to the side and up and down."""
    x, y, z = point - start
    ahead, left = x * math.cos(yaw_rad) + y * math.sin(yaw_rad), y * math.cos(yaw_rad) - x * math.sin(yaw_rad)
    return ahead > 0 and abs(left) < ahead and abs(z) < ahead


def test_a_cell_is_seen_if_its_centre_is_in_some_image_now_or_before():
    rig, before = ahead_of((0.3, 0.2, 0.1), 20.0), ahead_of((-0.4, 0.0, 0.2), 150.0)
    here, there = torch.eye(4, dtype=torch.float64), torch.eye(4, dtype=torch.float64)
    there[:2, 3] = torch.tensor([-3.1, 1.3])
    now = seen_cells(GRID, [(rig, here)], here)
    both = seen_cells(GRID, [(before, there), (rig, here)], here)
    places = [(np.array([0.3, 0.2, 0.1]), math.radians(20)), (np.array([-3.5, 1.3, 0.2]), math.radians(150))]
    for cell, centre in zip(np.ndindex(GRID.shape), GRID.centers(torch.float64).reshape(-1, 3).numpy(), strict=True):
        each = [sees(centre, *place) for place in places]
        assert bool(now[cell]) == each[0]
        assert bool(both[cell]) == any(each)
    assert 0 < now.float().mean() < both.float().mean() < 1
