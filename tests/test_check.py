"""`src/check.py` lists what is wrong with a dataset; predictions travel as files and get their scores."""

import shutil

import numpy as np
import pytest
from fake_scene import FakeWorld
from nuscenes_files import write_nuscenes
from scripts import run_script

from omniocc.check import read_back
from omniocc.data import OccupancyData
from omniocc.errors import UserError
from omniocc.geometry import Cylinder
from omniocc.runs.results import load_results

SMALL = ("data=occ3d_nuscenes", "data.source.val_every=2", "preset=smoke")


@pytest.fixture
def root(tmp_path):
    return write_nuscenes(tmp_path / "nuscenes", frames=2)


def check(root, *arguments):
    return run_script("check.py", *SMALL, f"data.source.root={root}", "--workers", "0", *arguments, cwd=root)


def test_a_whole_dataset_has_no_problems_and_is_drawn(root):
    result = check(root, "--draw", "drawn")
    assert result.returncode == 0, result.stdout + result.stderr
    assert result.stdout.splitlines()[0].split() == ["train", "1", "scenes,", "2", "frames"]
    assert result.stdout.splitlines()[-1] == "no problems"
    pictures = sorted(path.name for path in (root / "drawn").iterdir())
    assert pictures == ["test-scene-0003.png", "train-scene-0001.png", "val-scene-0002.png"]


def test_all_problems_are_listed_at_once_each_in_a_line(root):
    label = root / "gts" / "scene-0001" / "scene-0001-1" / "labels.npz"
    label.write_bytes(label.read_bytes()[:500])
    next((root / "samples" / "CAM_BACK").glob("scene-0002-0__*")).unlink()
    next((root / "samples" / "LIDAR_TOP").glob("scene-0003-1__*")).write_bytes(b"1234567")
    result = check(root)
    assert result.returncode == 1
    lines = [line for line in result.stdout.splitlines() if line.startswith("Occ3D-nuScenes, scene")]
    assert [line.split(":")[0].split("'", 1)[1] for line in lines] == [
        "scene-0001', frame 1",
        "scene-0002', frame 0",
        "scene-0003', frame 1",
    ]
    assert "3 problems" in result.stderr
    first = check(root, "--frames", "1")
    assert "1 problem" in first.stderr, first.stdout


def test_cells_that_a_source_cannot_know_are_refused(tmp_path):
    grid = Cylinder(shape=(4, 6, 2), radius_m=(0.0, 25.6), height_m=(-2.8, 3.6))
    data = OccupancyData(FakeWorld(tmp_path), 12, grid, 1, 2, 0, 0, ignore="unseen")
    with pytest.raises(UserError, match=r"data\.ignore=unseen: choose none or unobserved"):
        read_back(data, 0, 0, None)


def test_a_wrong_root_is_one_line(tmp_path):
    result = check(tmp_path)
    assert result.returncode == 1
    assert "v1.0-trainval, samples, gts not found, it holds nothing" in result.stderr
    assert "Traceback" not in result.stderr


def test_files_of_any_project_are_scored(root, tmp_path):
    folder = tmp_path / "theirs"
    folder.mkdir()
    for frame in range(2):
        name = f"scene-0003-{frame}"
        with np.load(root / "gts" / "scene-0003" / name / "labels.npz") as labels:
            np.savez_compressed(folder / f"{name}.npz", pred=labels["semantics"])
    command = (f"predictions={folder}", *SMALL, f"data.source.root={root}")
    result = run_script("evaluate.py", *command, cwd=tmp_path)
    assert result.returncode == 0, result.stdout + result.stderr
    facts, figures = load_results(tmp_path / "theirs-scores")
    assert figures["test/rayiou"] == figures["test/voxel/miou"] == figures["test/rayiou/manmade"] == 1
    assert figures["test/rayiou_past"] == figures["test/rayiou_now"] == figures["test/rayiou_future"] == 1
    assert "at most 2 origins a frame (where the car was in past, present and" in facts["protocol"]["rayiou"]
    ego = run_script("evaluate.py", *command, "--origins", "ego", cwd=tmp_path)
    facts, figures = load_results(tmp_path / "theirs-scores-ego")
    assert figures["test/rayiou"] == 1
    assert "test/rayiou_past" not in figures
    assert f"RayIoU: {facts['protocol']['rayiou']}.\nIoU, mIoU: cells count" in ego.stdout
    assert "from the ego origin; " in facts["protocol"]["rayiou"]
    shutil.move(folder / "scene-0003-1.npz", tmp_path / "elsewhere.npz")
    missing = run_script("evaluate.py", *command, cwd=tmp_path)
    assert missing.returncode == 1
    assert "scene-0003-1.npz: 1 of 2 predictions are missing" in missing.stderr
    np.savez_compressed(folder / "scene-0003-1.npz", pred=np.full((200, 200, 16), 40, np.uint8))
    wrong = run_script("evaluate.py", *command, cwd=tmp_path)
    assert "scene-0003-1.npz: the class ids [40] are not in the dataset's table, which has 0 to 17" in wrong.stderr
