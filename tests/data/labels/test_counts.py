"""Counts of classes: over frames that have labels, evenly spread over all scenes."""

import pytest
import torch
from fake_source import FRAMES, FakeFrames, FakeLabels

from omniocc.data.labels.counts import all_frames, count_classes
from omniocc.data.labels.own_grid import LazyLabels
from omniocc.errors import DataError
from omniocc.geometry import Cuboid

SCENES = [FakeFrames(f"scene{k}", k) for k in range(3)]
ONE_CELL = Cuboid((1, 1, 1), (0.0, 1.0), (0.0, 1.0), (0.0, 1.0))


class CellLabels(LazyLabels):
    """Labels of one cell, which no ray has crossed; it is noted which frames are read."""

    COUNTED = 4

    def __init__(self, folder, ignore):
        super().__init__(folder, "fingerprint", ONE_CELL, 2, ignore)
        self.frames: list[tuple[str, int]] = []

    def read(self, scene, frame):
        self.frames.append((scene.name, frame))
        return torch.full(ONE_CELL.shape, 255 if self.ignore == "unobserved" else 0, dtype=torch.uint8)


def test_frames_without_labels_do_not_count_as_free():
    """The last frame of each scene has no labels."""
    counts = FakeLabels().counts(SCENES)
    assert (counts.sum(0) == len(SCENES) * (FRAMES - 1)).all()


def test_a_label_that_is_no_class_is_named():
    class Wrong(FakeLabels):
        def read(self, scene, frame):
            return torch.tensor([[[0, 4, 255, 9, 9]]], dtype=torch.uint8)

    with pytest.raises(DataError, match=r"scene 'scene0', frame 0: its voxels have the classes \[9\].* 0 to 4,"):
        count_classes(Wrong(), all_frames(SCENES), 5, (1, 1, 5))
    assert count_classes(Wrong(), all_frames(SCENES), 10, (1, 1, 5)).sum() == len(SCENES) * FRAMES * 4


def test_the_counted_frames_are_spread_over_all_scenes(tmp_path):
    """Of nine frames every third one, since every second would be five, one too many."""
    labels = CellLabels(tmp_path, "none")
    assert labels.counts(SCENES).flatten().tolist() == [3, 0]
    assert labels.frames == [("scene0", 0), ("scene1", 0), ("scene2", 0)]


@pytest.mark.parametrize("first", ["none", "unobserved"])
def test_counts_are_kept_apart_by_what_unobserved_cells_are(tmp_path, first):
    for ignore in (first, {"none": "unobserved", "unobserved": "none"}[first]):
        counts = CellLabels(tmp_path, ignore).counts(SCENES)
        assert counts.flatten().tolist() == ([3, 0] if ignore == "none" else [0, 0])
