"""Checkpoints as files: what damaged, foreign and malicious ones may do."""

import itertools
import os
import resource
import zipfile
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import nn

from omniocc.config import CONF, ConfigError, compose_plain
from omniocc.errors import UserError
from omniocc.runs.checkpoint import check_parts, load_checkpoint
from omniocc.runs.trust import GROUPS, building, fault_of, not_offered


def write(path, config, stage="occupancy", weights=None):
    torch.save({"config": config, "state_dict": weights or {}, "stage": stage}, path)
    return path


@pytest.mark.parametrize("fraction", [0.0, 0.1, 0.5, 0.9, 0.99])
def test_a_truncated_checkpoint_is_named(fraction, tmp_path):
    weights = {f"model.{k}": torch.rand(100) for k in range(20)}
    path = write(tmp_path / "best.ckpt", {"seed": 1}, weights=weights)
    assert load_checkpoint(path).config["seed"] == 1
    content = path.read_bytes()
    path.write_bytes(content[: int(fraction * len(content))])
    with pytest.raises(UserError, match=r"best\.ckpt.*damaged.*move .*best\.ckpt elsewhere"):
        load_checkpoint(path)


def test_a_file_of_another_kind_is_refused(tmp_path):
    path = tmp_path / "weights.pt"
    torch.save({"weights": torch.rand(3)}, path)
    with pytest.raises(UserError, match=r"weights\.pt.*checkpoint.*runs/<run>/best\.ckpt") as told:
        load_checkpoint(path)
    assert "elsewhere" not in str(told.value)
    with pytest.raises(FileNotFoundError, match="there is no such checkpoint"):
        load_checkpoint(tmp_path / "none.ckpt")


def test_a_checkpoint_tells_its_stage_and_the_weights_of_its_model(tmp_path):
    path = write(tmp_path / "last.ckpt", {"model": {}}, "depth", {"model.a": torch.ones(1), "prior": torch.ones(2)})
    trained = load_checkpoint(path)
    assert trained.stage == "depth"
    assert list(trained.model_weights) == ["a"]
    torch.save({"config": {}, "state_dict": {}}, path)
    with pytest.raises(UserError, match=r"last\.ckpt.*older version"):
        load_checkpoint(path)


def checked(path, config, packages=()):
    check_parts(path, load_checkpoint(write(path, config)).config, ["model"], packages)


FOREIGN = {"model": {"_target_": "omniocc.model.OccupancyModel", "head": {"_target_": "mylib.parts.Head"}}}


def test_classes_of_another_package_are_one_line_that_says_how_to_allow_them(tmp_path):
    with pytest.raises(UserError, match=r"a\.ckpt.* mylib, .*OMNIOCC_PACKAGES=mylib .*packages=\[mylib\]") as caught:
        checked(tmp_path / "a.ckpt", FOREIGN)
    assert len(str(caught.value).splitlines()) == 1


def test_a_checkpoint_cannot_allow_packages_itself(tmp_path):
    with pytest.raises(UserError, match="mylib"):
        checked(tmp_path / "a.ckpt", FOREIGN | {"packages": ["mylib"]})


def test_the_environment_and_the_caller_can(tmp_path, monkeypatch):
    with pytest.raises(ConfigError, match="cannot be imported"):
        checked(tmp_path / "a.ckpt", FOREIGN, ["mylib"])
    monkeypatch.setenv("OMNIOCC_PACKAGES", "other,mylib")
    with pytest.raises(ConfigError, match="cannot be imported"):
        checked(tmp_path / "a.ckpt", FOREIGN)


EVIL = {"_target_": "pathlib.Path.write_text", "self": {"_target_": "pathlib.Path", "_args_": ["mark"]}, "data": "x"}
FORK = {"_target_": "omniocc.runs.fork_server.ForkServer", "script": "mark"}
SKETCH = {"_target_": "omniocc.model.sketch.Dense", "geometry": {"_target_": "omniocc.geometry.Cylinder"}}


def model(**parts):
    return {"model": {"_target_": "omniocc.model.OccupancyModel", **parts}}


@pytest.mark.parametrize(
    ("config", "message"),
    [
        (model(sketch={"_target_": "os.system"}), "it names classes of os$"),
        (model(sketch={"_target_": "torch.load"}), "names classes of torch"),
        (model(sketch=EVIL), "has the key model.sketch.self._args_"),
        (
            model(sketch={"_target_": "omniocc.io.os.system"}),
            "model.sketch names 'omniocc.io.os.system', and conf offers",
        ),
        (
            model(sketch=FORK),
            r"model.sketch names '.*ForkServer', and conf offers omniocc.model.sketch.Dense, .*Omni, .*Random",
        ),
        (model(sketch={**SKETCH, "geometry": FORK}), "model.sketch.geometry names"),
        (model(sketch={**SKETCH, "names": [[FORK]]}), r"model.sketch.names.0.0 names .* offers no class there"),
        (model(sketch={**SKETCH, "names": {"a": {"b": FORK}}}), r"model.sketch.names.a.b names .* no class there"),
        (model(refiner={"_target_": "omniocc.model.lifter.Coloring"}), "model.refiner names"),
        ({"model": FORK}, r"model names .* conf offers omniocc.model.OccupancyModel there"),
        ({"model": {"sketch": SKETCH}}, "its configuration has no model to build"),
        ({"model": [SKETCH]}, "its configuration has no model to build"),
        ({"model": "text"}, "its configuration has no model to build"),
        (model(sketch={**SKETCH, "_partial_": True}), "has the key model.sketch._partial_"),
        (model(sketch={**SKETCH, "_recursive_": False}), "has the key model.sketch._recursive_"),
        (model(sketch={"_target_": SKETCH}), "has the key model.sketch._target_, which only Hydra may read"),
        ({"model": "${evil}", "evil": FORK}, "at model has an interpolation"),
        (model(name="${oc.env:HOME}"), "at model.name has an interpolation"),
        (model(name=r"\${oc.create:{_target_:pathlib.Path.write_text}}"), "at model.name has an interpolation"),
        (model(name=r"\\\${a}"), "at model.name has an interpolation"),
        (model(**{"${oc.env:HOME}": 1}), "a key of its configuration below 'model' is no plain name"),
        (model(name="x" * 5000), "has more than 4096 letters"),
        (model(names=[0] * 30_000), "more than 20000 values"),
        (model(name=torch.ones(1)), "at model.name is no plain value"),
        ("model", "its configuration is no mapping, or empty"),
    ],
)
def test_a_checkpoint_may_name_options_of_the_slots_alone(config, message, tmp_path):
    with pytest.raises(UserError, match=message) as told:
        checked(tmp_path / "a.ckpt", config)
    assert str(told.value).startswith(str(tmp_path / "a.ckpt"))
    assert "\n" not in str(told.value)


def test_a_model_from_before_the_slot_of_hints_is_one_line(tmp_path):
    with pytest.raises(UserError, match=r"a.ckpt is of an older version: its model has no hints; train again$"):
        checked(tmp_path / "a.ckpt", model(sketch=SKETCH, evidence_in_volume=False))


def test_nesting_without_end_is_refused(tmp_path):
    deep = {}
    for _ in range(200):
        deep = {"a": deep}
    with pytest.raises(UserError, match="more than 20000 values or 30 levels"):
        checked(tmp_path / "a.ckpt", {"model": deep})


def test_classes_of_an_allowed_package_may_hold_options_of_a_model_and_nothing_else(tmp_path, monkeypatch):
    monkeypatch.setenv("OMNIOCC_PACKAGES", "mylib")
    own = {"_target_": "mylib.Sketch", "inner": SKETCH}
    with pytest.raises(ConfigError, match=r"mylib\.Sketch cannot be imported"):
        checked(tmp_path / "a.ckpt", model(sketch=own))
    with pytest.raises(UserError, match=r"model\.sketch\.inner names"):
        checked(tmp_path / "a.ckpt", model(sketch={**own, "inner": FORK}))


CHOICES = [
    "model=extended",
    "model=voxformer",
    "model=oneocc",
    "model=adaptiveocc",
    "model/lifter=lift_splat loss=with_coarse_ranges",
    "model/backbone=transformers",
    "model/backbone=efficientnet_lite0",
    "model/depth=mono optimizer=adamw loss=with_frustums",
    "data=occ3d_nuscenes data.source.root=x",
    "model=fosocc",
    "augment=disturbed +appearance=disturbed",
]


@pytest.mark.parametrize("choice", CHOICES)
def test_whatever_conf_offers_may_stand_in_a_file(choice):
    tree = compose_plain(CONF, "train", ["preset=smoke", *choice.split()])
    assert fault_of(tree) is None
    assert list(not_offered({root: tree[root] for root in GROUPS}, ["omniocc"])) == []


def test_building_from_a_file_has_bounds(tmp_path):
    path, weights = tmp_path / "a.ckpt", {"a": torch.ones(3)}
    with (
        pytest.raises(UserError, match=r"a.ckpt names sizes of a model that need far more"),
        building(path, weights),
    ):
        nn.Linear(1_000_000, 1_000_000)
    with pytest.raises(UserError, match=r"a.ckpt names sizes"), building(path, weights):
        np.zeros(10**12)
    with pytest.raises(UserError, match=r"a.ckpt names sizes"), building(path, weights):
        nn.ModuleList(nn.Linear(1, 1) for _ in itertools.count())
    nn.ModuleList(nn.Linear(1, 1) for _ in range(1000))
    with pytest.raises(UserError, match=r"a.ckpt .* cannot be built: ZeroDivisionError"), building(path, weights):
        print(1 // 0)
    assert resource.getrlimit(resource.RLIMIT_AS)[0] == resource.RLIM_INFINITY


def test_views_of_one_number_give_no_room_to_build(tmp_path):
    one = torch.ones(1).expand(2**60)
    with pytest.raises(UserError, match="names sizes"), building(tmp_path / "a", {"a": one, "b": one}):
        np.zeros(10**10)


@pytest.mark.parametrize(
    ("name", "weight"),
    [
        (5, torch.eye(2)),
        ("model.weight", torch.eye(2).to_sparse()),
        ("model.weight", torch.eye(2).to(torch.float8_e4m3fn)),
        ("model.weight", torch.eye(2, device="meta")),
        ("model.weight", torch.eye(2) * 1j),
        ("model.weight", torch.ones(1).expand(2**40)),
        ("model.weight", [1.0]),
    ],
)
def test_weights_are_tensors_in_which_a_network_computes(name, weight, tmp_path):
    with pytest.raises(UserError, match=r"a\.ckpt is damaged: its weights are no tensors of real numbers by name"):
        load_checkpoint(write(tmp_path / "a.ckpt", {}, weights={name: weight}))


def test_members_that_would_grow_are_refused(tmp_path):
    path = tmp_path / "a.ckpt"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as members:
        members.writestr("archive/data.pkl", bytes(10_000_000))
    with pytest.raises(UserError, match="but its parts state 10,000,000"):
        load_checkpoint(path)


class Evil:
    def __reduce__(self):
        return os.mkdir, ("mark",)


@pytest.mark.parametrize("new_format", [True, False])
def test_a_pickle_in_a_checkpoint_runs_nothing(new_format, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    content = {"config": {}, "state_dict": {}, "stage": "depth", "evil": Evil()}
    torch.save(content, "a.ckpt", _use_new_zipfile_serialization=new_format)
    with pytest.raises(UserError, match="is not a checkpoint of this platform, or it is damaged"):
        load_checkpoint(Path("a.ckpt"))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.ckpt"]
