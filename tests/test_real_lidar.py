"""Scores of ranges against the LiDAR of a real key frame."""

import pickle

import numpy as np
import pytest
import real_lidar
import torch
from numpy.testing._private.utils import runstring

from omniocc.errors import UserError


def test_points_are_compared_by_kind():
    points_m = torch.tensor([[4.0, 0, -1.5], [10.0, 0, -1.5], [0, 10.0, 0.5], [0, -20.0, 0.5]]).double()
    true_m = points_m.norm(dim=-1)
    range_m = true_m * torch.tensor([1.05, 1.2, 0.7, torch.nan])
    rows = real_lidar.compared(range_m, points_m, -1.5)
    assert rows["road"] == ["2", "100%", "50%", "100%"]
    assert rows["standing things"] == ["2", "50%", "0%", "0%"]
    assert rows["0-8.5 m"] == ["1", "100%", "100%", "100%"]
    assert rows["17-25.6 m"] == ["1", "0%", "0%", "0%"]


def test_a_folder_without_a_key_frame_is_named(tmp_path):
    with pytest.raises(UserError, match=r"holds 0 files \*\.pkl; one is needed"):
        real_lidar.read_key_frame(tmp_path)


@pytest.mark.parametrize("code", [pytest.raises, runstring], ids=["any", "in numpy"])
def test_pickles_that_name_code_are_refused(code, tmp_path):
    (tmp_path / "a.pkl").write_bytes(pickle.dumps(code))
    with pytest.raises(UserError, match="which is not read"):
        real_lidar.read_key_frame(tmp_path)


def test_arrays_and_numbers_are_read(tmp_path):
    kept = {"pose": np.eye(4), "time": np.float64(0.5), "name": "a"}
    (tmp_path / "a.pkl").write_bytes(pickle.dumps(kept, protocol=2))
    with (tmp_path / "a.pkl").open("rb") as file:
        found = real_lidar.PlainUnpickler(file).load()
    assert (found["pose"] == np.eye(4)).all()
    assert (found["time"], found["name"]) == (0.5, "a")


def test_a_flat_road_is_near_most_points_of_a_real_road(samples):
    frame = real_lidar.read_key_frame(samples / "nuscenes_demo")
    assert len(frame.rig.cameras) == 6
    road_z_m = frame.rig.road_z_m
    assert road_z_m == pytest.approx(-1.5, abs=0.1)
    flat_m = frame.points_m.norm(dim=-1) * road_z_m / frame.points_m[:, 2].clamp(max=-1e-9)
    rows = real_lidar.compared(flat_m, frame.points_m, road_z_m)
    assert rows["road"][3] == "90%"
