"""The dataset of docs/how_to/add_a_dataset.md: its code reads a folder in its layout, and trains on it."""

import re
from pathlib import Path

import cv2
import numpy as np
import pytest
from scripts import run_script

from omniocc.camera import Rig

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "how_to" / "add_a_dataset.md"
FILE = re.compile(r"^`([\w/.]+)`:\n\n```\w+\n(.*?)^```$", re.MULTILINE | re.DOTALL)
COMMAND = re.compile(r"^python src/(\w+\.py) (.*)$", re.MULTILINE)
ROAD_Z_M, WALL_M = -2.0, 6.0

pytestmark = [pytest.mark.slow(30), pytest.mark.whole_runs]


def write_drive(folder: Path) -> None:
    """Write two frames between two walls: images, LiDAR, voxels."""
    for name in ("lidar", "voxels"):
        (folder / name).mkdir(parents=True)
    rig = Rig.load("fisheye6").resized(64, 36)
    rig.save(folder / "rig.yaml")
    along, share = np.meshgrid(np.arange(-12, 12, 0.3), np.linspace(-1, 1, 30))
    road = np.stack([along, WALL_M * share, np.full_like(along, ROAD_Z_M), np.ones_like(along)], -1)
    walls = [np.stack([along, np.full_like(along, y_m), 2 * share, 2 + 0 * along], -1) for y_m in (-WALL_M, WALL_M)]
    points = np.concatenate([part.reshape(-1, 4) for part in (road, *walls)]).astype("<f4")
    labels = np.zeros((80, 80, 16), np.uint8)
    labels[10:70, 25:55, 2] = 1
    labels[10:70, [25, 54], 2:12] = 2
    for frame in range(2):
        for camera in rig.names:
            path = folder / f"images/{camera}/{frame:06d}.jpg"
            path.parent.mkdir(parents=True, exist_ok=True)
            cv2.imwrite(str(path), np.full((36, 64, 3), 90, np.uint8))
        (folder / f"lidar/{frame:06d}.bin").write_bytes(points.tobytes())
        np.savez(folder / f"voxels/{frame:06d}.npz", labels=labels, seen=np.ones(labels.shape, bool))
    poses = [np.c_[np.eye(3), [frame, 0.0, 0.0]].ravel() for frame in range(2)]
    (folder / "poses.txt").write_text("\n".join(" ".join(map(str, pose)) for pose in poses))


def test_the_code_of_the_page_reads_checks_and_trains(tmp_path):
    files = dict(FILE.findall(PAGE.read_text()))
    assert set(files) == {"mylib/__init__.py", "mylib/town.py", "mylib/conf/data/town.yaml"}
    for name, content in files.items():
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(content)
    for name in ("drive-01", "drive-02", "drive-03"):
        write_drive(tmp_path / "my_town" / name)
    commands = COMMAND.findall(PAGE.read_text())
    assert [script for script, _ in commands] == ["check.py", "train.py"]
    more = {
        "check.py": ["preset=tiny", "--workers", "0"],  # cells of 1.6 m, as of smoke, would leave none of the voxels
        "train.py": [
            "preset=smoke",
            "logger.mode=disabled",
            "test_images=0",
            "stages.occupancy.max_steps=2",
            "stages.depth.max_steps=2",
            "stages.sketch.max_steps=2",
        ],
    }
    for script, arguments in commands:
        words = arguments.replace("/data/my_town", str(tmp_path / "my_town")).split()
        result = run_script(
            script, *words, *more[script], cwd=tmp_path, PYTHONPATH=str(tmp_path), OMNIOCC_PACKAGES="mylib"
        )
        assert result.returncode == 0, result.stdout + result.stderr
    assert len(list((tmp_path / "drawn").iterdir())) == 3
    assert list(tmp_path.glob("runs/*/metrics.json"))
