"""How the time of an adaptation is shared, and what it shows."""

import re
from contextlib import nullcontext
from dataclasses import replace
from types import SimpleNamespace

import pytest
from omegaconf import OmegaConf

from omniocc import adapt as module
from omniocc.adapt import Plan, adapt, check_road, planned, rig_overrides, with_road_in_file
from omniocc.camera import Rig
from omniocc.config import check_root, quoted
from omniocc.errors import UserError
from omniocc.parts import Parts
from omniocc.predict.rig_file import write_rig_file
from omniocc.runs.script import train_config
from omniocc.train.start import load_fitting

SCORES = ("rayiou", "rayiou_0-8.5m", "lidar/rayiou", "voxel/iou", "voxel/miou")


@pytest.fixture
def rig(tmp_path):
    path = tmp_path / "my rig.yaml"
    write_rig_file("kannala_brandt", 3, path, False)
    return str(path)


@pytest.fixture
def words(tmp_path):
    return [f"paths.runs={tmp_path}/runs", f"paths.data={tmp_path}/data", "data.source.frames_per_scene=3"]


@pytest.fixture
def costs(monkeypatch):
    """Seconds of a step of each stage and of a frame, and bytes of a frame, which change what is measured."""
    found = {"depth": 0.25, "sketch": 0.5, "occupancy": 1.0, "frame": (0.2, 1e5)}
    monkeypatch.setattr(module, "step_seconds", lambda stage: found[stage.NAME])
    monkeypatch.setattr(module, "frame_cost", lambda alone, depth: found["frame"])
    return found


def plan_of(rig, words, minutes) -> Plan:
    cfg = train_config(["+adapt=any-rig", *rig_overrides(rig), *words])
    return planned(cfg, Parts(cfg).source(), 60 * minutes)


def test_images_have_the_rigs_shape_and_as_many_pixels_as_in_training(rig):
    named, size = rig_overrides(rig)
    assert named == f"data.source.rig='{rig}'"
    assert size == "data.source.image_size=[216,162]"  # of 1280 x 960 px, as predictions have it


@pytest.mark.parametrize("given", [(None, []), ("my_rig.yaml", ["data=recorded"])])
def test_cameras_or_recordings_are_needed(given):
    rig, words = given
    with pytest.raises(UserError, match=r"rig=my_rig.yaml, or recordings"):
        adapt(rig, None, 30, words)


def test_a_rig_that_does_not_exist_is_a_line():
    with pytest.raises(UserError, match=r"gone\.yaml"):
        rig_overrides("gone.yaml")


def test_the_height_of_the_road_must_be_known(rig, tmp_path):
    own = Rig.load(rig)
    replace(own, road_z_m=None).save(tmp_path / "level.yaml")
    with pytest.raises(UserError, match=r"level.yaml does not state the height of the road.*road_z_m"):
        rig_overrides(str(tmp_path / "level.yaml"))
    file = with_road_in_file(str(tmp_path / "level.yaml"), -1.4, tmp_path / "runs")
    assert Rig.load(file) == replace(own, road_z_m=-1.4)
    assert rig_overrides(file)[0] == f"data.source.rig={quoted(file)}"
    assert rig_overrides("fisheye6")  # whose frame is that of the virtual world


def test_the_plan_fills_the_time(rig, words, costs, capsys):
    plan = plan_of(rig, words, 30)
    frames = 3 * (plan.train_scenes + 24)
    used_s = 0.2 * frames + sum(costs[name] * steps for name, steps in plan.steps.items())
    assert 0.8 * 1800 < used_s + module.START_S < 0.86 * 1800  # the rest is for validation and tests
    spent_s = {name: costs[name] * steps for name, steps in plan.steps.items()}
    assert spent_s["depth"] / spent_s["occupancy"] == pytest.approx(0.3 / 0.55, rel=0.05)
    assert spent_s["sketch"] / spent_s["occupancy"] == pytest.approx(0.15 / 0.55, rel=0.05)
    _, *lines = (shown := capsys.readouterr().out).splitlines()
    minutes = [re.search(r": ([0-9]+):([0-9]+) min", line).groups() for line in lines]
    assert sum(60 * int(whole) + int(seconds) for whole, seconds in minutes) == pytest.approx(1800, abs=len(lines))
    assert {steps % 10 for steps in plan.steps.values()} == {0}
    assert f"{frames * 1e5 / 1e6:.0f} MB" in shown


def test_more_time_gives_more_streets_up_to_a_limit(rig, words, costs):
    assert [plan_of(rig, words, minutes).train_scenes for minutes in (3, 10, 30, 300)] == [51, 226, 480, 480]


def test_too_little_time_is_a_line(rig, words, costs):
    costs["occupancy"] = 60.0
    with pytest.raises(UserError, match=r"^minutes=5: no time is left for training"):
        plan_of(rig, words, 5)
    with pytest.raises(UserError, match="minutes=1: at least 5"):
        adapt(rig, None, 1, words)


def test_the_network_takes_all_of_the_weights(rig, words):
    cfg = train_config(["+adapt=any-rig", *rig_overrides(rig), *words])
    check_root(cfg)
    parts = Parts(cfg)
    assert "new are" not in load_fitting(parts.model(), cfg.weights, parts.config)


def test_the_same_call_goes_on_with_its_plan_and_ends_with_a_table(rig, words, costs, monkeypatch, tmp_path, capsys):
    trained = []

    def train(cfg):
        trained.append(OmegaConf.to_container(cfg.stages))

    def results(folder):
        assert folder.name.startswith("adapted-")
        return {}, {f"{row}/{key}": 0.4 for row in ("test", "prior", "label") for key in SCORES}

    monkeypatch.setattr(module, "train", train)
    monkeypatch.setattr(module, "load_results", results)
    monkeypatch.setattr(module, "as_they_are", lambda cfg, folder: {f"test/{key}": 0.2 for key in SCORES})
    (tmp_path / "runs").mkdir()
    for _ in range(2):
        adapt(rig, None, 30, words)
        costs["occupancy"] *= 2  # another machine, or a busy one
    steps = trained[0]["occupancy"]["max_steps"]
    assert [stages["occupancy"]["max_steps"] for stages in trained] == [steps, steps]
    assert steps > 0
    assert trained[0]["depth"]["max_steps"] > 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[-1].startswith("predict   python src/predict.py occupancy checkpoint=")
    assert lines[-1].endswith(f"rig='{rig}' images=my_images output=adapted")
    assert len(list((tmp_path / "runs").glob("adapt-*/plan.json"))) == 1
    (page,) = (tmp_path / "runs").glob("adapted-*/adapted.md")
    rows = [line.split("|")[1].strip() for line in page.read_text().splitlines()[2:6]]
    shipped, adapted = "weights 'any-rig' as they are", "adapted, 30 min"
    assert rows == ["baseline (no image)", shipped, adapted, "upper bound (true voxels)"]


def test_weights_as_they_are_are_scored_on_the_streets_seen_by_ones_own_rig(rig, words, tmp_path, monkeypatch):
    small = ["data.source.themes=[campus]", "data.source.frames_per_scene=1", "data.source.test_scenes=1"]
    small += ["data.ray_azimuths=24", "data.num_workers=0", "data.source.workers=0"]
    cfg = train_config(["+adapt=any-rig", *rig_overrides(rig), *words, *small])
    check_root(cfg)
    found = module.as_they_are(cfg, tmp_path / "shipped")
    folders = {path.name for path in Parts(cfg).source().folder.iterdir()}
    assert "test-000-campus" in folders
    assert not any(name.startswith(("train", "val")) for name in folders)
    assert found["prior/rayiou"] < found["test/rayiou"] < found["label/rayiou"] == 1
    monkeypatch.setattr(module, "score_checkpoint", None)  # once is enough
    assert module.as_they_are(cfg, tmp_path / "shipped") == pytest.approx(found, nan_ok=True)
    assert module.as_they_are(train_config(["data.num_classes=5"]), tmp_path / "others") is None


@pytest.mark.parametrize(("road_z_m", "fits"), [(-2.2, True), (-2.05, True), (None, True), (-1.6, False)])
def test_recordings_need_the_road_where_the_weights_expect_it(road_z_m, fits, rig, monkeypatch):
    scene = SimpleNamespace(rigs=[replace(Rig.load(rig), road_z_m=road_z_m)])
    spec = SimpleNamespace(road_of=lambda rig: rig.road_z_m)
    source = SimpleNamespace(prepare=lambda: None, scenes=lambda split: [scene], spec=spec, folder="my_scenes")
    with (
        nullcontext() if fits else pytest.raises(UserError, match=r"my_scenes: the road is 1.6 m .*origin_above_road_m")
    ):
        check_road(source)


def test_recordings_start_from_the_same_weights():
    own = ["data=recorded", "data.source.root=my_scenes"]
    recorded, rendered = (
        train_config([f"+adapt={name}", *own[:count]]) for name, count in (("any-rig-recorded", 2), ("any-rig", 0))
    )
    for key in ("model", "depth", "weights", "name"):
        assert recorded[key] == rendered[key]
    for key in ("sketch", "occupancy"):
        assert recorded.stages[key] == rendered.stages[key]
    assert recorded.stages.depth.max_steps == 0  # recordings may have no panoramas of ranges


def test_all_time_goes_to_the_stages_that_train(rig, words, costs):
    with_depth, without = (plan_of(rig, [*words, *more], 30).steps for more in ([], ["stages.depth.max_steps=0"]))
    assert without.keys() == {"sketch", "occupancy"}
    assert without["occupancy"] == pytest.approx(with_depth["occupancy"] / 0.7, rel=0.05)


def test_a_plan_alone_writes_nothing(rig, words, costs, tmp_path, capsys):
    adapt(rig, None, 30, [*words, "plan=true"])
    assert "occupancy" in capsys.readouterr().out
    assert not (tmp_path / "runs").exists()
