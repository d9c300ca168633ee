"""Sheets taken apart again."""

import numpy as np
import pytest
from fake_sweep import PICTURE, labels, sheet

from omniocc.geometry import Cylinder
from omniocc.report.gallery import cut, gallery
from omniocc.report.runs import by_row, read_runs
from omniocc.view import bev, error_bev, render_voxels

GRID = Cylinder(shape=(8, 10, 4))
TAG_PX = 40


def test_the_parts_of_a_sheet_are_what_was_put_on_it():
    parts = cut(sheet(GRID, 1))
    truth, prediction = labels(GRID, 0), labels(GRID, 1)
    size = len(parts.truth_map)
    expected = {
        "truth_map": bev(truth, GRID, size),
        "prediction_map": bev(prediction, GRID, size),
        "differences": error_bev(truth, prediction, GRID, size),
        "truth": render_voxels(truth, GRID, 623, 350),
        "prediction": render_voxels(prediction, GRID, 623, 350),
    }
    for name, picture in expected.items():
        part = getattr(parts, name)
        assert part.shape == picture.shape, name
        np.testing.assert_array_equal(part[TAG_PX:], picture[TAG_PX:], err_msg=name)
    assert parts.cameras.shape[1] == 1252
    assert (parts.cameras[-1] != 255).any()


def test_every_row_shows_the_same_frame_and_every_grid_its_truth_once(runs):
    (frame,) = gallery(by_row(read_runs(runs)))
    assert (frame.scene, frame.frame) == ("test-000-suburb", "000001")
    grids = {shown.row: shown.grid for shown in frame.shown}
    assert sorted(grids) == ["cuboid", "dense", "my <own>", "ours"]
    assert sorted(grids.values()) == ["", "", "cuboid", "cylinder"]
    assert next(shown.run.name for shown in frame.shown if shown.row == "ours") == "ours-00000001"


@pytest.mark.parametrize("name", ["test-00-odd.png", "val-step000040.png"])
def test_other_pictures_are_left_alone(runs, tmp_path, name):
    run = read_runs(runs)[0]
    (tmp_path / "pictures").mkdir()
    (tmp_path / "pictures" / name).write_bytes((run.folder / "pictures" / PICTURE).read_bytes())
    assert gallery({"ours": [run._replace(folder=tmp_path)]}) == []
