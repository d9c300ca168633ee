"""Checkpoints as files: what damaged, foreign and malicious ones may do."""

import pytest
import torch

from omniocc.config import ConfigError
from omniocc.errors import UserError
from omniocc.run.checkpoint import check_parts, load_checkpoint


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
    path = write(tmp_path / "last.ckpt", {}, "depth", {"model.a": torch.ones(1), "prior": torch.ones(2)})
    trained = load_checkpoint(path)
    assert trained.stage == "depth"
    assert list(trained.model_weights) == ["a"]
    torch.save({"config": {}, "state_dict": {}}, path)
    with pytest.raises(UserError, match=r"last\.ckpt.*older version"):
        load_checkpoint(path)


def checked(path, config, packages=()):
    check_parts(path, load_checkpoint(write(path, config)).config, ["model"], packages)


FOREIGN = {"model": {"head": {"_target_": "mylib.parts.Head"}}}


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


@pytest.mark.parametrize(
    "target",
    ["os.system", "omniocc.io.os.system", "omniocc.config.build", "omniocc.run.checkpoint_io.read_checkpoint"],
)
def test_nothing_but_classes_of_the_platform_is_built(target, tmp_path):
    for config in ({"model": {"_target_": target}}, {"model": "${evil}", "evil": {"_target_": target}}):
        with pytest.raises(UserError, match=r"os|not a class"):
            checked(tmp_path / "a.ckpt", config)
