import errno
import os
import re
import signal
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from fake_scene import FakeWorld
from filelock import FileLock

import omniocc
from omniocc import seeding
from omniocc.camera import Rig
from omniocc.code import code_fingerprint
from omniocc.data.source.recorded import spec_of
from omniocc.data.store.meta import RENDERED_REACH_M
from omniocc.data.store.reader import SceneReader
from omniocc.errors import DataError
from omniocc.geometry import Cuboid, Cylinder
from omniocc.parallel import worker_environment
from omniworld import THEMES, Scene, VirtualWorld
from omniworld.page import light_of, time_of_day
from omniworld.render.weather import WEATHERS, draw_weather

SCRIPT = """
import sys
from fake_scene import FakeWorld
if __name__ == "__main__":
    world = FakeWorld(sys.argv[1], workers=int(sys.argv[2]), delay_s=float(sys.argv[3]))
    world.prepare(world.plans[slice(*map(int, sys.argv[4:]))])
"""
SCENES = ["test-000-suburb", "train-000-downtown", "train-001-suburb", "val-000-downtown"]


def tree(folder):
    files = [path for path in Path(folder).rglob("*") if path.is_file() and ".locks" not in path.parts]
    return {str(path.relative_to(folder)): path.read_bytes() for path in files}


@pytest.fixture(scope="module")
def reference(tmp_path_factory):
    root = tmp_path_factory.mktemp("reference")
    FakeWorld(root).prepare()
    return root


@pytest.fixture
def render(tmp_path):
    """Starts rendering in a process of its own."""
    script = tmp_path / "script.py"
    script.write_text(SCRIPT)
    source = Path(omniocc.__file__).parents[1]
    env = os.environ | {"PYTHONPATH": f"{source}:{Path(__file__).parents[1]}", "OMP_NUM_THREADS": "1"}

    def start(root, workers, delay_s, mark, scenes=(0, 4)):
        command = [sys.executable, str(script), str(root), str(workers), str(delay_s), *map(str, scenes)]
        return subprocess.Popen(
            command,
            env=env | {"FAKE_SCENE_MARK": str(mark)},
            stderr=subprocess.PIPE,
            text=True,
            # a test run started in the background of a shell ignores Ctrl-C, and children inherit this
            preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
        )

    return start


def wait_for_frames(mark, count):
    give_up = time.monotonic() + 60
    while not mark.exists() or len(mark.read_text().splitlines()) < count:
        assert time.monotonic() < give_up
        time.sleep(0.02)


def test_the_plan(tmp_path):
    world = FakeWorld(tmp_path, scenes=(3, 2, 1))
    assert [plan.name for plan in world.plans] == [
        *("train-000-downtown", "train-001-suburb", "train-002-downtown"),
        *("val-000-downtown", "val-001-suburb", "test-000-suburb"),
    ]
    assert len({plan.seed for plan in world.plans}) == 6
    other = FakeWorld(tmp_path, scenes=(3, 2, 1), seed=1)
    assert not {plan.seed for plan in world.plans} & {plan.seed for plan in other.plans}


def test_the_papers_preset_has_four_scenes_of_each_theme(tmp_path):
    arguments = {"root": str(tmp_path), "rig": "fisheye6", "image_size": (32, 18), "themes": THEMES, "train_scenes": 24}
    arguments |= {"val_scenes": 4, "test_scenes": 4, "frames_per_scene": 1800, "frame_interval_s": 0.1}
    arguments |= {"supersample": 1, "erp_size": (8, 4), "erp_top_deg": 45.0, "erp_bottom_deg": -45.0}
    plans = VirtualWorld(**arguments).plans
    assert Counter(plan.theme for plan in plans) == dict.fromkeys(THEMES, 4)
    assert len(THEMES) == 8
    with pytest.raises(ValueError, match=r"weather.*hail.*clear"):
        VirtualWorld(**arguments, weather="hail")
    with pytest.raises(ValueError, match=r"capture.*lens.*direct, cubemap"):
        VirtualWorld(**arguments, capture="lens")
    for choice in ({"weather": "rain"}, {"label_mode": "geometry"}, {"capture": "cubemap"}, {"lidars": 8}):
        other = VirtualWorld(**arguments, **choice)
        assert other.folder != VirtualWorld(**arguments).folder
        assert other.plans == plans


def virtual_world(folder, **changes):
    arguments = {"root": str(folder), "rig": "fisheye6", "image_size": (32, 18), "themes": THEMES, "train_scenes": 16}
    arguments |= {"val_scenes": 8, "test_scenes": 4, "frames_per_scene": 1, "frame_interval_s": 0.5, "lidars": 1}
    arguments |= {"supersample": 1, "erp_size": (8, 4), "erp_top_deg": 45.0, "erp_bottom_deg": -45.0}
    return VirtualWorld(**arguments | changes)


def test_places_of_the_test_are_left_out_of_training(tmp_path):
    world = virtual_world(tmp_path, test_places=("oldtown", "campus"))
    places = {split: [plan.theme for plan in world.plans if plan.split == split] for split in ("train", "val", "test")}
    assert set(places["train"]) == set(places["val"]) == set(THEMES) - {"oldtown", "campus"}
    assert Counter(places["test"]) == {"oldtown": 2, "campus": 2}
    usual = virtual_world(tmp_path)
    assert world.folder == usual.folder  # scenes of the same names are the same, and are rendered once
    assert world.fingerprint != usual.fingerprint
    mixed = virtual_world(tmp_path, test_places=("oldtown", "campus"), weather="in_turn")
    assert {mixed.weather_of(plan) for plan in mixed.plans if plan.split == "test"} <= set(WEATHERS)
    for wrong in (("oldtwon",), THEMES):
        with pytest.raises(ValueError, match=r"test_places are .*leave others for training"):
            virtual_world(tmp_path, test_places=wrong)


def test_night_and_late_cameras_are_other_data_and_change_no_other_fingerprint(tmp_path):
    usual = virtual_world(tmp_path)
    assert {"variations", "late_camera_ms"}.isdisjoint(usual.recipe)
    worlds = [virtual_world(tmp_path, weather="night"), virtual_world(tmp_path, late_camera_ms=50.0)]
    worlds.append(virtual_world(tmp_path, late_camera_ms=100.0))
    assert len({world.name for world in (usual, *worlds)}) == 4
    assert all(world.plans == usual.plans and "variations" in world.recipe for world in worlds)
    assert worlds[0].weather_of(usual.plans[0]) == "night"
    with pytest.raises(ValueError, match="late_camera_ms is 300"):
        virtual_world(tmp_path, late_camera_ms=300)


def test_code_of_variations_does_not_count_for_the_world(tmp_path):
    (tmp_path / "variations").mkdir()
    (tmp_path / "scene.py").write_text("x = 1\n")
    before = code_fingerprint(tmp_path, ("variations",))
    (tmp_path / "variations" / "night.py").write_text("y = 2\n")
    code_fingerprint.cache_clear()
    assert code_fingerprint(tmp_path, ("variations",)) == before
    assert code_fingerprint(tmp_path) != before


def test_a_late_night_is_recorded(tmp_path):
    """The cameras take turns to be late; everything else is as in the scenes of another light."""
    options = {"frames_per_scene": 1, "themes": ("suburb",), "test_scenes": 1, "train_scenes": 0, "val_scenes": 0}
    late = virtual_world(tmp_path, weather="night", late_camera_ms=200.0, workers=0, **options)
    dusk = virtual_world(tmp_path, weather="dusk", workers=0, **options)
    for world in (late, dusk):
        world.prepare()
    (shown,), (usual,) = late.scenes("test"), dusk.scenes("test")
    assert shown.meta["facts"]["weather"] == "night"
    number = late.plans[0].seed % 6
    for camera, (new, old) in enumerate(zip(shown.pixel_labels(0), usual.pixel_labels(0), strict=True)):
        assert (new == old).all() == (camera != number)
    assert (shown.lidar(0).range_m == usual.lidar(0).range_m).all()
    assert time_of_day(shown.meta["facts"]) == "night"


def test_labels_end_where_the_recorded_points_do(tmp_path):
    world = virtual_world(tmp_path, train_scenes=1, val_scenes=0, test_scenes=0, workers=0)
    world.prepare()
    scene = world.scenes("train")[0]
    farthest = np.abs(scene.points(0).points_m).max(0)
    assert np.all(farthest < RENDERED_REACH_M)
    assert np.all(farthest[:2] > 25.5), "otherwise it ends earlier"
    far = Cuboid((100, 100, 4), (-40.0, 40.0), (-40.0, 40.0), (-2.8, 3.6))
    unknown = world.labels(far, "none").read(scene, 0) == 255
    assert unknown[0].all()
    assert not unknown[20:80, 20:80].any()
    near = Cylinder((8, 10, 4), (0.0, 25.6), (-2.8, 3.6))
    assert not (world.labels(near, "none").read(scene, 0) == 255).any()


def test_everything_that_decides_the_data_is_in_the_fingerprint(tmp_path):
    world = FakeWorld(tmp_path)
    assert world.fingerprint == FakeWorld(tmp_path / "elsewhere", workers=2).fingerprint
    more = FakeWorld(tmp_path, scenes=(3, 1, 1))
    assert more.fingerprint != world.fingerprint
    assert more.folder == world.folder  # scenes that exist are kept
    longer = FakeWorld(tmp_path, frames=5)
    assert longer.folder != world.folder


@pytest.mark.parametrize(("argument", "value"), [("frames", 0), ("workers", -1), ("scenes", (-1, 0, 0))])
def test_impossible_numbers_are_named(tmp_path, argument, value):
    with pytest.raises(ValueError, match=r"-1|0"):
        FakeWorld(tmp_path, **{argument: value})


def test_scenes_are_complete_and_record_how_they_were_made(reference):
    world = FakeWorld(reference)
    assert world.missing() == []
    reader = world.scenes("train")[1]
    assert reader.name == "train-001-suburb"
    assert len(reader) == 4
    assert reader.rig == world.rig
    assert reader.world_from_ego[:, 0, 3].tolist() == [0.0, 3.0, 6.0, 9.0]
    facts = reader.meta["facts"]
    assert (facts["split"], facts["theme"], facts["seed"]) == ("train", "suburb", 1)
    assert facts["spec"]["classes"]["11"]["name"] == "Roadline"
    assert facts["weather"] == weather_of("suburb", 1)


def weather_of(theme, seed):
    return draw_weather(seeding.generator(theme, seed, "light"))


def test_the_weather_of_a_scene_is_known_without_building_it():
    assert {weather_of("suburb", seed) for seed in range(40)} == set(WEATHERS)
    rig = Rig.load("fisheye6").resized(16, 9)
    for seed in (0, 3):
        drawn, named = Scene("suburb", seed, rig), Scene("suburb", seed, rig, weather=weather_of("suburb", seed))
        assert repr(drawn.snapshot(0.0)[0].light) == repr(named.snapshot(0.0)[0].light)
        assert repr(light_of("suburb", seed, weather_of("suburb", seed))) == repr(named.snapshot(0.0)[0].light)


@pytest.mark.whole_runs
@pytest.mark.parametrize("workers", [0, 2])
@pytest.mark.slow
def test_killed_while_rendering_ends_with_the_same_bytes(reference, tmp_path, render, workers, monkeypatch):
    root, mark = tmp_path / "data", tmp_path / "mark"
    process = render(root, workers, 0.05, mark)
    wait_for_frames(mark, 6)
    process.kill()
    process.wait()
    time.sleep(0.2)
    made = mark.read_text().splitlines()
    assert list(root.rglob("*.partial"))
    whole = [path.parent for path in root.glob("*/*/meta.json") if path.parent.suffix != ".partial"]
    assert {len(SceneReader(folder)) for folder in whole} <= {4}
    time.sleep(0.2)
    assert mark.read_text().splitlines() == made  # no worker outlives its parent
    monkeypatch.setenv("FAKE_SCENE_MARK", str(mark))
    FakeWorld(root).prepare()
    assert tree(root) == tree(reference)
    again = mark.read_text().splitlines()
    unfinished = [line for line in made if line.split()[0] not in {folder.name for folder in whole}]
    assert len(again) - len(set(again)) == len(unfinished)  # no whole scene was made again


@pytest.mark.whole_runs
@pytest.mark.slow
def test_ctrl_c_leaves_no_process_and_the_same_command_ends(reference, tmp_path, render):
    root, mark = tmp_path / "data", tmp_path / "mark"
    process = render(root, 2, 0.05, mark)
    wait_for_frames(mark, 3)
    process.send_signal(signal.SIGINT)
    _, stderr = process.communicate(timeout=30)
    assert process.returncode != 0
    assert "KeyboardInterrupt" in stderr
    made = mark.read_text()
    time.sleep(0.3)
    assert mark.read_text() == made
    FakeWorld(root).prepare()
    assert tree(root) == tree(reference)


@pytest.mark.parametrize("workers", [0, 2])
def test_a_failing_frame_is_named_and_the_rest_kept(reference, tmp_path, workers):
    world = FakeWorld(tmp_path, workers=workers, fail_at=("train-001-suburb", 2))
    with pytest.raises(RuntimeError, match=r"train-001-suburb.*frame 2.*ZeroDivisionError.*street"):
        world.prepare()
    FakeWorld(tmp_path).prepare()
    assert tree(tmp_path) == tree(reference)


@pytest.mark.whole_runs
@pytest.mark.slow
def test_two_runs_on_one_folder(reference, tmp_path, render, monkeypatch):
    root, mark = tmp_path / "data", tmp_path / "mark"
    other = render(root, 0, 0.05, mark)
    wait_for_frames(mark, 1)
    monkeypatch.setenv("FAKE_SCENE_MARK", str(mark))
    FakeWorld(root, delay_s=0.05).prepare()
    assert other.wait() == 0
    assert tree(root) == tree(reference)
    frames = mark.read_text().splitlines()
    assert len(frames) == len(set(frames)) == 16  # they share the work


@pytest.mark.whole_runs
@pytest.mark.slow
def test_jobs_of_a_few_scenes_each_make_one_dataset(reference, tmp_path, render):
    root = tmp_path / "data"
    marks = [tmp_path / "first", tmp_path / "second"]
    jobs = [render(root, 0, 0.0, mark, scenes) for mark, scenes in zip(marks, ((0, 1), (1, 4)), strict=True)]
    assert [job.wait() for job in jobs] == [0, 0]
    assert tree(root) == tree(reference)
    assert {line.split()[0] for line in marks[0].read_text().splitlines()} == {"train-000-downtown"}
    assert len(marks[1].read_text().splitlines()) == 12
    again = render(root, 0, 0.0, tmp_path / "third")
    assert again.wait() == 0
    assert not (tmp_path / "third").exists()  # a second run makes nothing


@pytest.mark.whole_runs
def test_a_limit_on_the_size_of_files_gives_one_line_and_loses_nothing(reference, tmp_path):
    script = (
        "import resource, sys; from fake_scene import FakeWorld\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (70_000, 70_000))\n"
        "try: FakeWorld(sys.argv[1]).prepare()\n"
        "except OSError as error: sys.exit(str(error))"
    )
    env = os.environ | {"PYTHONPATH": f"{Path(omniocc.__file__).parents[1]}:{Path(__file__).parents[1]}"}
    done = subprocess.run([sys.executable, "-c", script, tmp_path], env=env, capture_output=True, text=True)
    assert done.returncode == 1
    (line,) = done.stderr.splitlines()
    assert re.fullmatch(
        r"cannot write .*train-000-downtown: files may not grow .*; it continues where it stopped", line
    )
    assert [path.name for path in tmp_path.glob("*/train*")] == ["train-000-downtown.partial"]
    FakeWorld(tmp_path).prepare()
    assert tree(tmp_path) == tree(reference)


def test_a_read_only_folder_gives_one_line(tmp_path, monkeypatch):
    def refuse(path, *_, **__):
        raise OSError(errno.EROFS, "Read-only file system", str(path))

    monkeypatch.setattr(Path, "mkdir", refuse)
    with pytest.raises(DataError, match=r"write .*read-only.*paths\.data="):
        FakeWorld(tmp_path).prepare()


def test_workers_import_the_script_only_if_they_must(monkeypatch):
    file = __file__
    monkeypatch.setattr(sys.modules["__main__"], "__file__", file, raising=False)  # a worker of xdist has none
    with worker_environment(needs_main=False):
        assert sys.modules["__main__"].__file__ is None
        assert os.environ["OMP_NUM_THREADS"] == "1"
        assert os.environ["PYTHONPATH"].startswith(str(Path(omniocc.__file__).parents[1]))
    assert sys.modules["__main__"].__file__ == file
    with worker_environment(needs_main=True):
        assert sys.modules["__main__"].__file__ == file


def test_a_scene_held_by_another_process_is_waited_for(tmp_path, capsys, monkeypatch):
    world = FakeWorld(tmp_path, scenes=(2, 0, 0))
    locks = world.folder / ".locks"
    locks.mkdir(parents=True)
    (locks / "train-000-downtown.owner").write_text('{"pid": 4711, "host": "elsewhere"}')
    held = FileLock(locks / "train-000-downtown.lock")
    held.acquire()
    monkeypatch.setattr("omniocc.progress.Progress.wait", lambda _, text: (print(text), held.release()))
    world.prepare()
    assert "another process (pid 4711 on elsewhere) makes train-000-downtown, waiting" in capsys.readouterr().out
    assert world.missing() == []


def test_missing_scenes_and_a_folder_that_cannot_be_written(tmp_path):
    world = FakeWorld(tmp_path / "data")
    with pytest.raises(DataError, match=r"train-000-downtown.*missing.*prepare"):
        world.scenes("train")
    (tmp_path / "data").write_text("a file where the folder should be")
    with pytest.raises(DataError, match=r"cannot write .*data"):
        world.prepare()


def test_the_road_of_a_drawn_rig_lies_where_the_rig_says(tmp_path):
    """The car heaves by a tenth of a metre on its springs; heights of these rigs differ by more than .8 m."""
    world = VirtualWorld(
        str(tmp_path), "random", (48, 27), ["suburb", "arterial"], 6, 0, 0, 1, 0.5, 1, (16, 4), 45.0, -45.0, lidars=1
    )
    heights_m = [world.rig_of(plan).road_z_m for plan in world.plans]
    plans = [world.plans[heights_m.index(height_m)] for height_m in (min(heights_m), max(heights_m))]
    world.prepare(plans)
    for plan in plans:
        reader = world.reader(plan)
        points = reader.points(0)
        near = np.hypot(*points.points_m[:, :2].T) < 6
        road_m = points.points_m[near & (points.labels == world.spec.classes.names.index("Road")), 2]
        assert len(road_m) > 20
        assert np.median(road_m) == pytest.approx(world.spec.road_of(reader.rig), abs=0.3)
    assert max(heights_m) - min(heights_m) > 0.8


def test_the_origin_of_every_scene_lies_where_it_is_wanted(tmp_path):
    arguments = {"root": str(tmp_path), "rig": "random", "image_size": (48, 27), "themes": ["suburb"]}
    numbers = {"train_scenes": 60, "val_scenes": 0, "test_scenes": 0, "frames_per_scene": 1, "frame_interval_s": 0.5}
    panorama = {"supersample": 1, "erp_size": (64, 16), "erp_top_deg": 45.0, "erp_bottom_deg": -45.0}
    at_rig, at_grid, drawn = (
        VirtualWorld(**arguments, **numbers, **panorama, origin_above_road_m=where) for where in (None, 2.2, "drawn")
    )
    plan = at_rig.plans[0]
    for world in (at_rig, at_grid):
        world.prepare([plan])
    low, high = (world.reader(plan) for world in (at_rig, at_grid))
    road_m = low.rig.road_z_m
    assert at_grid.spec.road_z_m == spec_of(high).road_z_m == pytest.approx(high.rig.road_z_m) == pytest.approx(-2.2)
    raised = (high.world_from_ego[0] - low.world_from_ego[0])[:3, 3]
    assert np.linalg.norm(raised) == pytest.approx(road_m + 2.2)
    assert all(map(np.array_equal, low.images(0), high.images(0)))
    road_class, heights_m = at_grid.spec.classes.names.index("Road"), []
    for scene in (low, high):
        points = scene.points(0)
        near = (np.hypot(*points.points_m[:, :2].T) < 6) & (points.labels == road_class)
        heights_m.append(np.median(points.points_m[near, 2]))
    assert heights_m[1] == pytest.approx(-2.2, abs=0.3)  # the road is curved
    assert heights_m[1] - heights_m[0] == pytest.approx(-2.2 - road_m, abs=0.05)
    # a flat road below: at the lower edge of the panorama its range is proportional to the height of the origin
    bottom_m = [np.median(scene.erp_range_m(0)[-1]) for scene in (low, high)]
    assert bottom_m[1] / bottom_m[0] == pytest.approx(2.2 / -road_m, rel=0.1)
    assert drawn.spec.road_z_m is None
    above = [(-drawn.rig_of(one).road_z_m, -at_rig.rig_of(one).road_z_m) for one in drawn.plans]
    assert 10 < sum(origin_m == pytest.approx(rig_m) for origin_m, rig_m in above) < 30
    assert 10 < sum(origin_m == pytest.approx(2.2) for origin_m, _ in above) < 30
    assert all(min(rig_m, 2.2) - 1e-6 <= origin_m <= max(rig_m, 2.2) + 1e-6 for origin_m, rig_m in above)
    with pytest.raises(ValueError, match="origin_above_road_m is -1; it must be above 0 and at most 10, or drawn"):
        VirtualWorld(**arguments, **numbers, **panorama, origin_above_road_m=-1)


def test_drawn_rigs_are_recorded_with_errors_and_share_weathers_evenly(tmp_path):
    arguments = {"root": str(tmp_path), "rig": "random", "image_size": (48, 27), "themes": [*THEMES, "solids"]}
    numbers = {"train_scenes": 90, "val_scenes": 9, "test_scenes": 0, "frames_per_scene": 1, "frame_interval_s": 0.5}
    panorama = {"supersample": 1, "erp_size": (16, 4), "erp_top_deg": 45.0, "erp_bottom_deg": -45.0}
    world = VirtualWorld(**arguments, **numbers, **panorama, weather="in_turn", repainted_fraction=0.5, lidars=1)
    plans = world.plans[:90]
    assert len({world.rig_of(plan) for plan in plans}) == 90
    pairs = Counter((plan.theme, world.weather_of(plan)) for plan in plans)
    assert set(pairs.values()) == {2}
    assert len(pairs) == 45
    true, recorded = world.rig_of(plans[0]), world.calibration_of(plans[0])
    assert recorded.cameras == true.cameras
    assert recorded.road_z_m == true.road_z_m
    assert 0 < (recorded.ego_from_camera - true.ego_from_camera).abs().max() < 0.02
    world.prepare(plans[:1])
    reader = world.reader(plans[0])
    assert reader.rig == recorded
    assert len(reader.images(0)) == len(true.cameras)
    assert world.spec.road_z_m is spec_of(reader).road_z_m is None
    assert spec_of(reader).road_of(reader.rig) == true.road_z_m
    reader.meta["facts"]["spec"]["road_z_m"] = -2.2  # as scenes said that were rendered before
    assert spec_of(reader).road_z_m is None
    assert world.name != VirtualWorld(**arguments, **numbers, **panorama, weather="in_turn", lidars=1).name
