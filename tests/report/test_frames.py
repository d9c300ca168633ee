"""Parts of sheets, shown side by side for all rows."""

import shutil

import numpy as np
import pytest
from fake_sweep import SHEET, parts, save_parts

from omniocc.geometry import Cylinder
from omniocc.report.runs import read_runs
from omniocc.report.selection import by_row
from omniocc.report.write import compared_frames


def test_every_row_shows_the_same_frame_and_every_grid_its_truth_once(runs):
    (frame,) = compared_frames(by_row(read_runs(runs)))
    assert (frame.scene, frame.frame) == ("test-000-suburb", "000001")
    grids = {shown.row: shown.grid for shown in frame.shown}
    assert sorted(grids) == ["cuboid", "dense", "my <own>", "ours"]
    assert sorted(grids.values()) == ["", "", "cuboid", "cylinder"]
    assert next(shown.run.name for shown in frame.shown if shown.row == "ours") == "ours-00000001"


def test_parts_are_shown_as_they_were_saved(runs):
    (frame,) = compared_frames(by_row(read_runs(runs)))
    drawn = parts(Cylinder(shape=(8, 10, 4)), 1)
    shown = next(shown.parts for shown in frame.shown if shown.row == "ours")
    for name, image in drawn._asdict().items():
        np.testing.assert_array_equal(getattr(shown, name), image, err_msg=name)


def test_a_run_without_parts_is_left_out_with_a_line(runs, tmp_path, capsys):
    run = read_runs(runs)[0]._replace(folder=tmp_path)
    capsys.readouterr()
    (tmp_path / "images").mkdir()
    assert compared_frames({"ours": [run]}) == []
    assert capsys.readouterr().err == "", "no image was asked for"
    save_parts(tmp_path / "images", parts(Cylinder(shape=(8, 10, 4)), 1))
    folder = tmp_path / "images" / "parts" / SHEET
    assert len(compared_frames({"ours": [run]})) == 1
    (folder / "truth.png").write_bytes(b"damaged")
    (folder / "cameras.png").unlink()
    assert compared_frames({"ours": [run]}) == []
    assert capsys.readouterr().err == f"left out of the compared frames: {folder} lacks cameras, truth\n"
    shutil.rmtree(folder.parent)
    assert compared_frames({"ours": [run]}) == []
    assert capsys.readouterr().err.startswith(
        f"left out of the compared frames: {folder} lacks cameras, truth, prediction"
    )


@pytest.mark.parametrize("name", ["test-00-odd", "val-step000040"])
def test_other_pictures_are_left_alone(runs, tmp_path, name):
    run = read_runs(runs)[0]._replace(folder=tmp_path)
    save_parts(tmp_path / "images", parts(Cylinder(shape=(8, 10, 4)), 1))
    for folder, ending in (("", ".png"), ("parts", "")):
        (tmp_path / "images" / folder / f"{SHEET}{ending}").rename(tmp_path / "images" / folder / f"{name}{ending}")
    assert compared_frames({"ours": [run]}) == []
