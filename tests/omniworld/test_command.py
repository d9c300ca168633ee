"""What a render refuses, and says about disk, before it begins."""

from collections import namedtuple

import pytest
from fake_scene import FakeWorld
from scripts import run_script

from omniocc.data import DataError
from omniocc.data.store.shard import SceneWriter
from omniworld import THEMES, VirtualWorld
from omniworld.command import announcement, bytes_to_come, existing, frame_bytes

MEASURED_KB = {
    ((256, 144), (180, 45), "lidar20"): 570,
    ((512, 288), (720, 180), "lidar20"): 1034,
    ((1024, 576), (720, 180), "lidar20"): 2350,
    ((512, 288), (720, 180), "geometry"): 1500,
}


@pytest.mark.parametrize("case", MEASURED_KB, ids=str)
def test_sizes_of_frames_are_those_of_rendered_ones(tmp_path, case):
    size, erp, label_mode = case
    world = VirtualWorld(
        *(str(tmp_path), "fisheye6", size, THEMES, 1, 0, 0, 10, 0.1, 2, erp, 45.0, -45.0), label_mode=label_mode
    )
    assert frame_bytes(world) == pytest.approx(1000 * MEASURED_KB[case], rel=0.06)


def disk(monkeypatch, free):
    usage = namedtuple("usage", "total used free")
    monkeypatch.setattr("omniworld.command.shutil.disk_usage", lambda _: usage(free, 0, free))


def test_what_is_coming_is_said_and_a_full_disk_stops_it(tmp_path, monkeypatch):
    world = FakeWorld(tmp_path / "not" / "yet")
    needed = 16 * frame_bytes(world)
    assert bytes_to_come(world, world.plans) == needed
    disk(monkeypatch, needed)
    line = f"{world.place}: 4 of 4 scenes to render, 16 frames, about {needed / 1e6:.0f} MB, {needed / 1e6:.0f} MB free"
    assert announcement(world, world.plans) == line
    disk(monkeypatch, needed - 1)
    with pytest.raises(DataError, match=r"4 scenes of 4 frames.*space.*paths\.data="):
        announcement(world, world.plans)
    assert not (tmp_path / "not").exists()


def test_what_is_there_is_not_counted_again(tmp_path):
    world = FakeWorld(tmp_path)
    world.prepare(world.plans[:2])
    writer = SceneWriter(world.folder / world.plans[2].name)
    writer.append({"a": bytes(1000)}, {})
    writer.close()
    assert bytes_to_come(world, world.missing()) == 8 * frame_bytes(world) - 1536
    assert "2 of 4 scenes to render, 2 exist, 8 frames" in announcement(world, world.plans)
    world.prepare(world.plans[3:])
    assert announcement(world, world.plans[:2]).endswith("all 2 scenes exist")


def test_the_nearest_folder_that_is_there(tmp_path):
    assert existing(tmp_path / "a" / "b") == tmp_path
    assert existing(tmp_path) == tmp_path


def test_numbers_that_are_none_are_named(tmp_path):
    result = run_script("render.py", "preset=smoke", "frames=abc", "scenes=2.5", "first_scene=-1", cwd=tmp_path)
    assert result.returncode == 1
    assert result.stderr.splitlines()[1:] == [
        "  scenes: 2.5 is not a whole number from 1 to 1,000,000,000 or null",
        "  frames: 'abc' is not a whole number from 1 to 1,000,000,000 or null",
        "  first_scene: -1 is not a whole number from 0 to 1,000,000,000",
    ]
