import numpy as np
import pytest
import torch

from omniocc.data.labels.ray_votes import RayVotes, count_rays, rays_seen, vote_rays
from omniocc.data.source import LidarScan
from omniocc.errors import DataError
from omniocc.geometry import Cuboid
from omniocc.loss import Rays, RayWindow

LINE = Cuboid((8, 1, 1), (0.0, 8.0), (-1.0, 1.0), (-1.0, 1.0))
ROWS = [
    ((0.1, 0, 0), (5.5, 0, 0), 2),
    ((0.1, 0, 0), (5.6, 0, 0), 2),
    ((0.1, 0, 0), (5.4, 0, 0), 1),
    ((3.2, 0.5, 0), (3.2, 0.1, 0), 255),
]


def rays():
    origins, ends, labels = zip(*ROWS, strict=True)
    return Rays(torch.tensor(origins)[None], torch.tensor(ends)[None], torch.tensor([labels], dtype=torch.uint8))


class Scene:
    name = "line"
    world_from_ego = np.eye(4)[None]

    def __init__(self, label):
        self.label = label

    def __len__(self):
        return 1

    def lidar(self, frame):
        direction = np.array([[1, 0, 0]], np.float32)
        origin = np.array([[0.1, 0, 0]], np.float32)
        return LidarScan(np.array([4.5], np.float32), np.array([self.label], np.uint8), direction, origin)


def test_hits_vote_and_cells_that_rays_leave_are_free():
    assert vote_rays(LINE, rays(), 4).flatten().tolist() == [0, 0, 0, 255, 0, 2, 255, 255]


def test_rays_that_cross_a_cell_or_end_in_it_are_counted():
    assert rays_seen(LINE, rays()).flatten().tolist() == [3, 3, 3, 4, 3, 3, 0, 0]


def test_a_ray_without_a_hit_frees_its_whole_way():
    origins, ends = torch.tensor([[[2.5, 0, 0]]]), torch.tensor([[[1000.0, 0, 0]]])
    votes = vote_rays(LINE, Rays(origins, ends, torch.zeros(1, 1, dtype=torch.uint8)), 4)
    assert votes.flatten().tolist() == [255, 255, 0, 0, 0, 0, 0, 0]


def votes_of(tmp_path):
    return RayVotes(tmp_path, LINE, RayWindow([0], True), "data", num_classes=4)


def test_votes_are_kept_beside_those_of_other_windows(tmp_path):
    votes = votes_of(tmp_path)
    scenes = [Scene(2)]
    votes.prepare(scenes)
    expected = [0, 0, 0, 0, 2, 255, 255, 255]
    assert votes.read(scenes[0], 0).flatten().tolist() == expected
    scenes[0].label = 3
    assert votes.read(scenes[0], 0).flatten().tolist() == expected, "read from the file"
    assert RayVotes(tmp_path, LINE, RayWindow([0, 1], True), "data").folder != votes.folder
    assert RayVotes(tmp_path, LINE, RayWindow([0], True), "others").folder != votes.folder, "one folder, other frames"


def test_hits_of_unknown_class_are_occupied_where_there_is_one_class():
    origins, ends = torch.tensor([[[0.1, 0, 0]]]), torch.tensor([[[4.6, 0, 0]]])
    one = Rays(origins, ends, torch.full((1, 1), 255, dtype=torch.uint8))
    assert vote_rays(LINE, one, 2).flatten().tolist() == [0, 0, 0, 0, 1, 255, 255, 255]
    assert vote_rays(LINE, one, 4).flatten().tolist() == [0, 0, 0, 0, 255, 255, 255, 255]


def test_votes_of_rays_without_any_class_are_one_line(tmp_path):
    with pytest.raises(DataError, match=r"^no ray .* hits a known class: loss=lidar_rays loss\.rays\.classes=false"):
        votes_of(tmp_path).counts([Scene(255)])


def counts_of(scenes, classes=True):
    return count_rays(scenes, LINE, RayWindow([0], classes), 4)


def test_counts_have_as_many_hits_as_places_before_them():
    """The ray is 4.5 m long, and its 8 places lie 0.5 m apart: one in the first cell, then two in each."""
    counts = counts_of([Scene(2), Scene(2)]).flatten(1)
    free = [3 * 2 * n for n in (2, 2, 2, 2, 0, 0, 0, 0)]
    assert counts[0].tolist() == free
    assert counts[2].tolist() == [0, 0, 0, 0, sum(free), 0, 0, 0]
    assert not counts[[1, 3]].any()


def test_hits_of_unknown_class_count_for_all_classes_alike():
    counts = counts_of([Scene(255), Scene(255)], classes=False).flatten(1)
    assert counts[1:, 4].tolist() == [16, 16, 16]
    assert counts[0].sum() == 48
    mixed = counts_of([Scene(255), Scene(2)]).flatten(1)
    assert mixed[1:, 4].tolist() == [8, 32, 8]


def test_rays_that_are_to_have_classes_but_have_none_are_one_line():
    with pytest.raises(DataError, match=r"^no ray .* hits a known class: .*loss\.rays\.classes=false uses none$"):
        counts_of([Scene(255)])


def test_frames_without_rays_are_one_line():
    scene = Scene(2)
    scene.lidar = lambda frame: None
    with pytest.raises(DataError, match=r"^the training frames have no LiDAR scan that crosses the grid; .*voxels$"):
        counts_of([scene])


def test_a_frame_without_a_scan_is_unknown(tmp_path):
    scene = Scene(2)
    scene.lidar = lambda frame: None
    assert votes_of(tmp_path).read(scene, 0).unique().tolist() == [255]
