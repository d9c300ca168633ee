"""Curves out of CSV files, finished ones and those that are being written."""

import pytest

from omniocc.errors import UserError
from omniocc.runs.curves import read_curve, read_curves


def write(folder, version, *lines):
    path = folder / "csv" / f"version_{version}"
    path.mkdir(parents=True)
    (path / "metrics.csv").write_text("\n".join(lines) + "\n")


def test_a_resumed_run_is_one_curve(tmp_path):
    write(tmp_path, 2, "step,val/rayiou,train/loss", "19,,5", "29,0.3,")
    write(tmp_path, 10, "train/loss,step", "4,39")
    write(tmp_path, 0, "step,train/loss,val/rayiou", "9,9,", "19,8,", "19,,0.1", "29,7,")
    assert read_curve(tmp_path, "train/loss") == {9: 9.0, 19: 5.0, 39: 4.0}
    assert read_curve(tmp_path, "val/rayiou") == {29: 0.3}
    assert read_curve(tmp_path / "nothing", "val/rayiou") == {}


def test_copies_of_folders_are_left_out(tmp_path):
    write(tmp_path, 0, "step,train/loss", "9,9")
    write(tmp_path, "0 (copy)", "step,train/loss", "9,7")
    write(tmp_path, "old", "step,train/loss", "9,8")
    assert read_curve(tmp_path, "train/loss") == {9: 9.0}


def test_a_file_that_is_being_written_gives_its_complete_lines(tmp_path):
    write(tmp_path, 0, "step,train/loss,val/rayiou", "9,9.5,", "19,8.25,", "19,nan,0.5")
    path = tmp_path / "csv" / "version_0" / "metrics.csv"
    whole = read_curves(tmp_path)
    assert whole == {"train/loss": {9: 9.5, 19: 8.25}, "val/rayiou": {19: 0.5}}
    for length in range(len(path.read_text())):
        (tmp_path / "part" / "csv" / "version_0").mkdir(parents=True, exist_ok=True)
        (tmp_path / "part" / "csv" / "version_0" / "metrics.csv").write_text(path.read_text()[:length])
        part = read_curves(tmp_path / "part")
        assert all(whole[key][step] == value for key, curve in part.items() for step, value in curve.items())
    path.write_text("step,train/loss\n9,1.0\nno step,2.0\n19\n29,3.0,4.0\n")
    assert read_curves(tmp_path) == {"train/loss": {9: 1.0}}


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("9,\0", "it is no text in UTF-8: line 2 holds the byte 0x00"),
        ("9,low", "train/loss is 'low'"),
        ("9," + "1" * 2**18, "field larger than"),
    ],
)
def test_a_damaged_file_is_named(line, said, tmp_path):
    write(tmp_path, 0, "step,train/loss", line)
    with pytest.raises(UserError, match=rf"metrics\.csv is damaged: {said}"):
        read_curves(tmp_path)
