import re
import shutil
from functools import partial

import numpy as np
import pytest
from fake_scene import FakeWorld

from omniocc.data.labels.voxels import vote
from omniocc.data.store.check import check_scene, survey, survey_scene
from omniocc.geometry import Cylinder

GRID = Cylinder(shape=(8, 10, 4), radius_m=(0.0, 25.6), height_m=(-2.8, 3.6))


@pytest.fixture
def scene(tmp_path):
    world = FakeWorld(tmp_path, scenes=(1, 0, 0))
    world.prepare()
    return world.scenes("train")[0]


def test_a_whole_scene_has_no_problem(scene):
    assert check_scene(scene, 4, 0.5) == []
    assert "4 frames instead of 5" in check_scene(scene, 5, 0.5)[0]


def test_a_flipped_byte_anywhere_in_a_shard_is_found(scene):
    shard = scene.folder / "frames-001.tar"
    frame = scene.index.shard.tolist().index(1)
    member = scene.index.members.index("range2.zst")
    offset = scene.index.offset[frame, member]
    whole = shard.read_bytes()
    for at, words in (
        (offset + 3, f"frame {frame}, member 'range2.zst': checksum differs"),
        (offset - 500, "checksum"),
    ):
        raw = bytearray(whole)
        raw[at] ^= 32
        shard.write_bytes(raw)
        problems = check_scene(scene, 4, 0.5)
        assert any(words in problem and "train-000-downtown" in problem for problem in problems), problems


def test_a_flip_of_any_single_byte_is_found(scene):
    whole = {path: path.read_bytes() for path in scene.folder.iterdir()}
    rng = np.random.default_rng(5)
    for path, content in whole.items():
        for at in rng.integers(0, len(content), 12).tolist():
            raw = bytearray(content)
            raw[at] ^= 1 << int(rng.integers(8))
            path.write_bytes(raw)
            problems = check_scene(type(scene)(scene.folder), 4, 0.5)
            assert problems, (path.name, at)
            assert "train-000-downtown" in problems[0]
        path.write_bytes(content)
    assert check_scene(type(scene)(scene.folder), 4, 0.5) == []


def test_each_missing_or_short_file_is_named(scene, tmp_path):
    for name in ("frames-000.tar", "rig.yaml", "index.json", "meta.json"):
        kept = tmp_path / "kept"
        shutil.copy(scene.folder / name, kept)
        (scene.folder / name).unlink()
        problems = check_scene(type(scene)(scene.folder), 4, 0.5)
        assert len(problems) == 1
        assert problems[0].startswith(f"{scene.folder / name}: ")
        assert "the file is missing" in problems[0]
        shutil.copy(kept, scene.folder / name)
    with (scene.folder / "frames-000.tar").open("r+b") as file:
        file.truncate(5000)
    assert "5000 bytes instead of" in check_scene(scene, 4, 0.5)[0]


@pytest.mark.parametrize(
    ("harm", "words"),
    [
        (lambda poses: poses[2, :3, 3].__iadd__(40.0), "frame 2: its pose jumps: 142 m/s"),
        (
            lambda poses: poses.__setitem__((3, slice(2), slice(2)), [[0, -1], [1, 0]]),
            "frame 3: .*jumps: 180 degrees/s",
        ),
        (lambda poses: poses.__setitem__((1, 0, 0), 1.1), "frame 1: its pose is no rotation and shift"),
        (lambda poses: poses.__setitem__((1, 2, 2), -1), "frame 1: its pose is no rotation and shift"),
        (lambda poses: poses.__setitem__((2, 0, 3), np.nan), "frame 2: its pose jumps: nan m/s"),
    ],
)
def test_poses_that_jump_or_bend_are_named(scene, harm, words):
    harm(scene.world_from_ego)
    problems = check_scene(scene, 4, 0.5)
    assert re.search(words, problems[0]), problems


def test_wrong_times_are_named(scene):
    assert "frame 1: its time is 0.5 s instead of 0.1 s (3 frames are off)" in check_scene(scene, 4, 0.1)[0]
    scene.time_s[2] = 0.5
    assert "frame 2: its time is 0.5 s instead of 1 s (1 frames are off)" in check_scene(scene, 4, 0.5)[0]


@pytest.mark.parametrize("workers", [0, 2])
def test_a_survey_counts_classes_and_lists_problems(tmp_path, workers):
    world = FakeWorld(tmp_path, scenes=(3, 0, 0))
    world.prepare()
    scenes = world.scenes("train")
    (scenes[1].folder / "rig.yaml").unlink()
    found = survey(partial(survey_scene, 4, 0.5, GRID, 2), scenes, workers)
    assert [len(result.problems) for result in found] == [0, 1, 0]
    cells = np.concatenate([vote(scenes[2], frame, GRID).numpy().ravel() for frame in (0, 3)])
    assert found[2].voxels.tolist() == np.bincount(cells, minlength=12).tolist()
