"""The stages that run, the hashes of their results, and waiting for other processes."""

import threading
import time

import pytest

from omniocc.errors import UserError
from omniocc.parts import Parts
from omniocc.progress import STATUS_FILE, read_status
from omniocc.train.stage_keys import stage_keys, wanted_stages
from omniocc.train.stages import lock_folder, stages_of


@pytest.fixture
def omni(smoke):
    return lambda *overrides: smoke("model/sketch=omni", *overrides)


@pytest.fixture
def changed(omni):
    """Return the names of the keys that the overrides change."""

    def names(*overrides: str) -> list[str]:
        before, after = stage_keys(omni(), "data"), stage_keys(omni(*overrides), "data")
        return [name for name in before._fields[:3] if getattr(before, name) != getattr(after, name)]

    return names


def test_a_learned_sketch_has_stages_before_occupancy(omni):
    assert wanted_stages(omni()) == ("depth", "sketch", "occupancy")
    assert wanted_stages(omni("stage=sketch")) == ("depth", "sketch")
    assert wanted_stages(omni("stage=depth")) == ("depth",)
    assert wanted_stages(omni("model/sketch=dense")) == ("occupancy",)


def test_a_missing_stage_is_an_error_with_a_remedy(omni):
    with pytest.raises(UserError, match=r"stage=skethc.*depth, sketch, occupancy"):
        wanted_stages(omni("stage=skethc"))
    with pytest.raises(UserError, match=r"stage=depth: this model/sketch has no such stage"):
        wanted_stages(omni("model/sketch=dense", "stage=depth"))


@pytest.mark.parametrize(
    ("override", "expected"),
    [
        ("model/depth=truth", ["depth", "sketch", "candidates"]),
        ("stages.depth.max_steps=5", ["depth", "sketch", "candidates"]),
        ("trainer.gradient_clip_val=1.0", ["depth", "sketch", "candidates"]),
        ("model/geometry=cuboid", ["sketch", "candidates"]),
        ("data.ignore=unobserved", ["sketch", "candidates"]),
        ("stages.sketch.seed=3", ["sketch", "candidates"]),
        ("model.sketch.dilation_m=[0,0,0]", ["candidates"]),
        ("model.sketch.threshold=0.4", ["candidates"]),
        ("loss=lidar_rays", ["sketch", "candidates"]),
        ("loss=with_first_hits", []),
        ("model/refiner=none", []),
        ("stages.occupancy.max_steps=5", []),
        ("stages.occupancy.validate_every_n_epochs=2", []),
        ("trainer.accelerator=cpu", []),
        ("trainer.devices=2", ["depth", "sketch", "candidates"]),
        ("data.samples_per_scene=2", ["depth", "sketch", "candidates"]),
        ("data.range_edges_m=[0,9]", ["depth", "sketch", "candidates"]),
        ("trainer.strategy=ddp", []),
        ("seed=3", ["depth", "sketch", "candidates"]),
        (("seed=3", "stages.depth.seed=0", "stages.sketch.seed=0"), []),
        ("paths.runs=elsewhere", []),
    ],
)
def test_keys_depend_only_on_what_decides_the_result(override, expected, changed):
    assert changed(*([override] if isinstance(override, str) else override)) == expected


def test_the_sketch_of_rays_depends_on_their_frames_alone(omni):
    """Whether they have classes does not matter: a sketch tells occupied from free."""
    frames = "loss.rays.frames=[0,1]"
    voted, rays, geometry, window = (
        stage_keys(omni(*words), "data").sketch
        for words in (
            ["loss=voted_rays"],
            ["loss=lidar_rays"],
            ["loss=lidar_rays", "loss.rays.classes=false"],
            ["loss=lidar_rays", frames],
        )
    )
    assert rays == geometry
    others = ("loss.weights.rays=5", "+loss.voxel.dice._target_=omniocc.loss.Dice")
    assert rays not in [stage_keys(omni("loss=lidar_rays", other), "data").sketch for other in others]
    assert len({voted, rays, window, stage_keys(omni(), "data").sketch}) == 4


def test_other_data_is_another_result(omni):
    one, other = (stage_keys(omni(), data)._asdict() for data in "ab")
    assert [name for name in one if one[name] != other[name]] == ["depth", "sketch", "candidates"]


def test_what_networks_find_that_are_used_as_they_are_does_not_depend_on_the_data(omni, tmp_path):
    """One more scene does not compute all panoramas again."""
    (weights := tmp_path / "last.ckpt").write_text("weights")
    as_it_is = [[f"stages.{stage}.weights={weights}", f"stages.{stage}.max_steps=0"] for stage in ("depth", "sketch")]

    def found(*overrides, data="a"):
        return stage_keys(omni(*overrides), data)[3:]

    assert found() == found("stages.depth.max_steps=0") == found(*as_it_is[1]) == (None,) * 3
    ranges, *none = found(*as_it_is[0])
    assert ranges is not None
    assert none == [None, None]
    assert found("model/depth=sweep")[0] is not None, "which has no weights"
    both = found(*as_it_is[0], *as_it_is[1])
    assert None not in both
    assert both == found(*as_it_is[0], *as_it_is[1], "seed=3", "trainer.gradient_clip_val=1.0", data="b")
    other = found(*as_it_is[0], *as_it_is[1], "model.sketch.threshold=0.4")
    assert [one == same for one, same in zip(both, other, strict=True)] == [True, True, False]
    weights.write_text("others")
    assert not set(both) & set(found(*as_it_is[0], *as_it_is[1]))


def test_a_second_process_waits_and_reports_it(tmp_path, monkeypatch, capsys):
    events, status = [], tmp_path / "status.json"
    monkeypatch.setenv(STATUS_FILE, str(status))

    def second():
        with lock_folder(tmp_path, "depth"):
            events.append("second")

    with lock_folder(tmp_path, "depth"):
        thread = threading.Thread(target=second)
        thread.start()
        while (reported := read_status(status)) is None or reported.state != "waiting":
            time.sleep(0.01)
        assert str(tmp_path) in reported.title
        assert reported.title in capsys.readouterr().out
        events.append("first")
    thread.join(timeout=10)
    assert events == ["first", "second"]


@pytest.mark.slow
def test_one_more_scene_computes_the_ranges_of_that_scene_alone(smoke, data_root, tmp_path, monkeypatch):
    frames = []

    def found(scenes, *overrides):
        parts = Parts(
            smoke(
                f"paths.data={data_root}",
                f"paths.runs={tmp_path}",
                "test_images=0",
                *overrides,
                f"data.source.train_scenes={scenes}",
                "logger.mode=disabled",
            )
        )
        data = parts.data()
        data.prepare_data()
        depth = stages_of(parts, data)[0]
        outputs = depth.outputs()
        counted = outputs._replace(predict=lambda *given: frames.append(1) or outputs.predict(*given))
        monkeypatch.setattr(depth, "outputs", lambda: counted)
        frames.clear()
        depth.run("depth")
        return len(frames)

    as_it_is = "model/depth=sweep"  # it has no weights
    assert [found(2, as_it_is), found(3, as_it_is), found(2, as_it_is), found(3, as_it_is)] == [8, 2, 0, 0]
    trained = "stages.depth.max_steps=1"
    assert [found(2, trained), found(3, trained)] == [8, 10], "other scenes give another network"
