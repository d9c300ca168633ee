import shutil

import pytest
from fake_scene import FakeWorld

from omniocc.data.check import check_scene


@pytest.fixture
def scene(tmp_path):
    world = FakeWorld(tmp_path, scenes=(1, 0, 0))
    world.prepare()
    return world.readers("train")[0]


def test_a_whole_scene_has_no_problem(scene):
    assert check_scene(scene, 4, 0.5) == []
    assert "4 frames instead of 5" in check_scene(scene, 5, 0.5)[0]


def test_a_flipped_byte_anywhere_in_a_shard_is_found(scene):
    shard = scene.folder / "frames-001.tar"
    frame = next(at for at, record in enumerate(scene.index["frames"]) if record["shard"] == 1)
    member = scene.index["members"].index("range2.zst")
    offset = scene.index["frames"][frame]["offset"][member]
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
