"""What is checked before anything is made."""

from pathlib import Path
from types import SimpleNamespace

import pytest
import torch

from omniocc.config import build
from omniocc.errors import UserError
from omniocc.parts import Parts
from omniocc.predict.trained import check_overrides, check_places
from omniocc.train import occupancy
from omniocc.train.build import check_devices, line_on_lifter


def test_a_machine_that_lacks_what_is_asked_for_is_a_line(smoke):
    check_devices(Parts(smoke()))
    if torch.cuda.is_available():
        pytest.skip("this machine has a GPU")
    with pytest.raises(UserError) as caught:
        check_devices(Parts(smoke("trainer.accelerator=gpu")))
    assert str(caught.value).startswith("trainer.accelerator=gpu trainer.devices=1 trainer.strategy=auto:")
    assert "\n" not in str(caught.value)


def test_a_value_that_the_trainer_does_not_take_is_named(smoke):
    with pytest.raises(UserError, match=r"^trainer.limit_val_batches=-3.0: the trainer cannot do that"):
        check_devices(Parts(smoke("trainer.limit_val_batches=-3.0")))


def test_a_class_that_the_trainer_cannot_build_is_told_with_the_reason(smoke):
    with pytest.raises(UserError, match=r"trainer\.strategy=fsdp: .* cannot do that \(.*\w.*\)$") as caught:
        check_devices(Parts(smoke("trainer.strategy=fsdp")))
    assert "problem in the configuration" not in str(caught.value)
    with pytest.raises(UserError, match=r"cannot do that"):
        check_devices(Parts(smoke("+trainer.max_time=1")))


def test_classes_of_pixels_without_a_head_are_named_before_anything_is_trained(make_task):
    with pytest.raises(UserError, match=r"model.hints.pixel_classes=true needs a 2D head"):
        make_task("model/semantic_head=none", "model.hints.pixel_classes=true")


@pytest.mark.parametrize(("override", "label"), [((), 0), (("occupied_above=0.25",), 1), (("occupied_above=0.5",), 0)])
def test_a_training_is_validated_with_its_own_threshold(make_task, monkeypatch, override, label):
    task = make_task(*override)
    logits = torch.tensor([0.0, -0.5]).view(1, 2, 1, 1, 1)  # free, and a class of probability 0.38
    monkeypatch.setattr(occupancy, "model_inputs", lambda batch: ())
    monkeypatch.setattr(task.stream, "windows", lambda exists, frames: logits)
    assert task.evaluate(SimpleNamespace(images=torch.zeros(1, 1), exists=None, frame_ids=[])).item() == label


@pytest.mark.parametrize("lifter", ["coloring", "coarse_coloring", "pillar"])
def test_one_key_hands_evidence_to_the_queries_of_every_lifter_that_takes_it(make_task, lifter):
    for used in (True, False):
        model = make_task("model=extended", f"model/lifter={lifter}", f"model.hints.queries={used}").model
        assert any(".evidence." in f".{name}" for name, _ in model.lifter.named_parameters()) == used


@pytest.mark.parametrize(
    "overrides",
    [
        ("model/lifter=lift_splat", "model.hints.queries=true"),
        ("model.lifter.evidence=true",),
        ("model.hints.queries=true", "model.lifter.evidence=false"),
    ],
)
def test_queries_that_would_get_no_evidence_or_no_stored_one_are_named(make_task, overrides):
    with pytest.raises(UserError, match=r"model.hints.queries=(True|False) and this model/lifter do not fit"):
        make_task(*overrides)


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("dta.source.root=/x", r"dta.source.root: this has no effect on a.ckpt; only keys of data, model"),
        ("trainer.limit_test_batches=1", "trainer.limit_test_batches: this has no effect"),
        ("model/sketch=mono", "model/sketch: a.ckpt keeps the options that it was trained with; single keys of data"),
        ("data=recorded", r"data: a.ckpt keeps its data, .*predict.py occupancy"),
        ("model.geometry.radius_m=[0,50]", "model.geometry.radius_m: a.ckpt was trained on its grid"),
    ],
)
def test_overrides_of_a_checkpoint_that_do_not_what_they_say_are_refused(override, message):
    check_overrides(Path("a.ckpt"), ["data.source.root=/x", "model.temporal.frames=1"])
    with pytest.raises(UserError, match=message):
        check_overrides(Path("a.ckpt"), ["data.source.root=/x", override])


def test_it_is_said_that_a_lifter_ends_before_the_grid_does(smoke):
    def line(*overrides):
        model = Parts(smoke(*overrides)).model()
        return line_on_lifter(model.lifter, model.geometry)

    far = "model.geometry.x_m=[-50,50]", "model.geometry.y_m=[-50,50]"
    for model in ("flashocc", "fosocc", "adaptiveocc"):
        assert line(f"model={model}") is None
        assert line(f"model={model}", *far).startswith("model.lifter.range_m ends at 37 m")
        assert line(f"model={model}", *far, "model.lifter.range_m=[1,71]") is None
    assert line("model/geometry=cuboid", *far) is None


def test_a_file_does_not_choose_where_data_are_made(tmp_path, monkeypatch, smoke):
    there = tmp_path / "there"
    there.mkdir()
    monkeypatch.chdir(there)

    def taken(*given, **places):
        source = build(smoke("data.source.workers=0").data.source)
        source.root, source.cache = places.get("root", "data"), places.get("cache")
        check_places(Path("a.ckpt"), source, given)

    taken()
    taken(root=str(there / "data"), cache="cache")
    taken("data.source.root", root="/elsewhere")
    for key, place in [("root", str(tmp_path)), ("root", "../x"), ("cache", "/elsewhere"), ("root", "s3://bucket/x")]:
        with pytest.raises(UserError, match=rf"^a.ckpt names {place} .*name it yourself: data.source.{key}={place}$"):
            taken(**{key: place})
    (tmp_path / build(smoke("data.source.workers=0").data.source).name).mkdir()
    taken(root=str(tmp_path))
    recorded = SimpleNamespace(root=str(tmp_path), folder=tmp_path / "omniocc")
    check_places(Path("a.ckpt"), recorded, ())  # such a source only reads there
