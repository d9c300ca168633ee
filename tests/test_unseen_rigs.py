"""The rigs that training never draws, and their scores."""

import numpy as np
import pytest
import torch
import unseen_rigs

from omniocc.camera import Equirectangular, Rig
from omniocc.model.depth import Spheres
from omniocc.model.ops.depth.depth_map import from_index
from omniworld.drawn import COUNTS, HEIGHT_M, LENSES, RADIUS_M

NAMES = tuple(unseen_rigs.UNSEEN)
PANORAMA = Equirectangular(48, 12, 45.0, -45.0)
SPHERES = Spheres(32, 0.9)


@pytest.mark.parametrize("name", NAMES)
def test_training_cannot_draw_the_rig(name):
    row, rig = unseen_rigs.UNSEEN[name], unseen_rigs.unseen_rig(name)
    largest_m = 1.2 * RADIUS_M[1]
    unseen = row.lens not in LENSES, not HEIGHT_M[0] <= row.height_m <= HEIGHT_M[1], row.radius_m > largest_m
    assert any((*unseen, row.count > max(COUNTS)))
    assert len(rig.cameras) == (row.count or 4)
    assert rig.road_z_m == -row.height_m
    assert unseen_rigs.unseen_rig(name) == rig


def test_twelve_rigs_and_their_own_networks(tmp_path):
    assert len(NAMES) == 12
    assert set(unseen_rigs.OWN) <= set(NAMES)
    unseen_rigs.unseen_rig("ocam_car").save(tmp_path / "rig.yaml")
    assert Rig.load(tmp_path / "rig.yaml") == unseen_rigs.unseen_rig("ocam_car")


class Frames:
    """Two frames with a wall at 10 m and sky above."""

    def __init__(self, rig):
        self.rigs = (rig, rig)
        self.range_m = np.full((12, 48), 10.0, np.float32)
        self.range_m[:3] = np.inf

    def __len__(self):
        return 2

    def erp_range_m(self, frame):
        return self.range_m


class Data:
    """The test frames of a rig."""

    def __init__(self, rig):
        self.source = self
        self.spec = type("Spec", (), {"range_edges_m": (0.0, 8.5, 17.0, 25.6)})()
        self.frames = Frames(rig)

    def scenes(self, split):
        return [self.frames] if split == "test" else []


class Guess(torch.nn.Module):
    """Ranges that are 20 % too far to the left, and valid only where the index is above that of the sky."""

    panorama = PANORAMA

    def __init__(self):
        super().__init__()
        self.present = []

    def rig_spheres(self, rig):
        return SPHERES

    def forward(self, images, rigs):
        self.present.append((images.flatten(2).amax(-1) > 0)[0].tolist())
        range_m = torch.full((1, 12, 48), 10.0)
        range_m[..., 24:] = 12.0
        valid = torch.ones(1, 12, 48, dtype=torch.bool)
        valid[:, -1] = False
        return from_index(SPHERES.index(range_m), valid, torch.full((1, 12, 48), 0.5), SPHERES)


@pytest.mark.parametrize("without", [None, 2])
def test_scores_of_a_known_error(without, monkeypatch):
    rig = unseen_rigs.unseen_rig("ring10")
    camera = rig.cameras[0]
    images = torch.full((len(rig.cameras), 3, camera.height, camera.width), 100, dtype=torch.uint8)
    monkeypatch.setattr(unseen_rigs, "read_images", lambda *_: images)
    model = Guess()
    scores = unseen_rigs.score(model, Data(rig), without)
    assert scores["mae"] == pytest.approx(1.0, abs=0.05)
    assert scores["mae_8.5-17m"] == pytest.approx(scores["mae"])
    assert np.isnan(scores["mae_0-8.5m"])
    assert scores["answered"] == pytest.approx(8 / 9, abs=0.03)  # of nine rows with a surface
    # half of the eight rows with a surface; in the three rows of sky a range is wrong
    assert scores["right, several"] == pytest.approx(4 / 11, abs=0.03)
    assert scores["ece, several"] == pytest.approx(abs(scores["right, several"] - 0.5), abs=1e-6)
    assert all(seen.count(False) == (without is not None) for seen in model.present)


def test_the_table_has_a_row_for_each_rig_and_the_mean_of_the_network_under_test():
    rows = {"a": {"mae": 1.0}, "a (own)": {"mae": 9.0}, "b": {"mae": 3.0}}
    assert unseen_rigs.table(rows).splitlines()[2:] == [
        "| a | 1.00 |",
        "| a (own) | 9.00 |",
        "| b | 3.00 |",
        "| mean | 2.00 |",
    ]
