import json

import numpy as np
import pytest
import torch
from safetensors.torch import load_file, save_file

from omniocc.errors import UserError
from omniocc.runs import weights as module
from omniocc.runs.checkpoint import load_checkpoint
from omniocc.runs.weights import FORMAT, SUFFIX, digest_of, find_checkpoint, pack_weights, read_weights, shipped

WEIGHTS = {"model.a": torch.randn(3, 4), "model.steps": torch.tensor(7), "prior": torch.arange(4, dtype=torch.uint8)}
CONFIG, FACTS = {"model": {"num_classes": 12}, "data": {"rig": "fisheye6"}}, {"steps": 30, "commit": "abc"}


@pytest.fixture
def packed(tmp_path):
    path = tmp_path / f"own{SUFFIX}"
    pack_weights(path, "occupancy", CONFIG, WEIGHTS, FACTS)
    return path


def test_what_is_packed_is_read_as_a_checkpoint(packed):
    content, facts = read_weights(packed)
    assert facts == FACTS
    trained = load_checkpoint(packed)
    assert (trained.stage, trained.config) == ("occupancy", CONFIG)
    assert content["state_dict"].keys() == trained.weights.keys() == WEIGHTS.keys()
    assert all(torch.equal(trained.weights[name], value) for name, value in WEIGHTS.items())
    assert set(trained.model_weights) == {"a", "steps"}


def test_what_does_not_fit_16_bits_is_kept_in_32(tmp_path):
    weights = {"running_var": torch.tensor([66263.0, 1.0 + 2**-20]), "weight": torch.tensor([1.0 + 2**-20])}
    pack_weights(tmp_path / f"a{SUFFIX}", "depth", CONFIG, weights, FACTS, half=True)
    found = read_weights(tmp_path / f"a{SUFFIX}")[0]["state_dict"]
    assert torch.equal(found["running_var"], weights["running_var"])
    assert found["weight"] == 1.0


def test_half_is_half_as_large_and_read_as_floats(tmp_path):
    large = {"model.a": torch.randn(100, 100), "model.steps": torch.tensor(7)}
    paths = [tmp_path / f"{half}{SUFFIX}" for half in (False, True)]
    for path in paths:
        pack_weights(path, "depth", CONFIG, large, FACTS, half=path.stem == "True")
    sizes = [path.stat().st_size for path in paths]
    assert sizes[1] < 0.55 * sizes[0]
    read = read_weights(paths[1])[0]["state_dict"]
    assert read["model.a"].dtype == torch.float32
    torch.testing.assert_close(read["model.a"], large["model.a"], atol=2e-3, rtol=1e-3)
    assert torch.equal(read["model.steps"], large["model.steps"])


def test_equal_weights_make_equal_files(packed, tmp_path):
    pack_weights(tmp_path / f"again{SUFFIX}", "occupancy", CONFIG, dict(reversed(WEIGHTS.items())), FACTS)
    assert (tmp_path / f"again{SUFFIX}").read_bytes() == packed.read_bytes()


def test_damage_is_named(packed):
    whole = packed.read_bytes()
    packed.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(UserError, match=r"own.safetensors is damaged"):
        read_weights(packed)
    changed = bytearray(whole)
    changed[-3] ^= 1
    packed.write_bytes(changed)
    with pytest.raises(UserError, match=r"own.safetensors is damaged: .*hash"):
        load_checkpoint(packed)
    with pytest.raises(FileNotFoundError, match="no such file of weights"):
        read_weights(packed.with_name("lost.safetensors"))


@pytest.mark.parametrize(
    ("key", "value"),
    [("stage", None), ("stage", 3), ("config", [1]), ("config", "text"), ("facts", None), ("facts", []), ("sha256", 7)],
)
def test_a_header_with_a_value_of_another_type_is_named(key, value, tmp_path):
    path = tmp_path / f"own{SUFFIX}"
    about = {"stage": "depth", "config": CONFIG, "facts": FACTS, "sha256": digest_of(WEIGHTS)} | {key: value}
    save_file(WEIGHTS, path, {FORMAT: json.dumps(about)})
    with pytest.raises(UserError, match=rf"own.safetensors is damaged: its header .*its {key} is "):
        read_weights(path)


def test_files_of_others_are_named(tmp_path):
    path = tmp_path / f"other{SUFFIX}"
    save_file({"a": torch.zeros(2)}, path)
    assert load_file(path)
    with pytest.raises(UserError, match="not a file of weights of this platform"):
        read_weights(path)


def test_names_stand_for_shipped_weights_where_there_is_no_such_path(tmp_path, monkeypatch, packed):
    monkeypatch.setattr(module, "SHIPPED", tmp_path)
    monkeypatch.chdir(tmp_path)
    assert shipped() == ["own"]
    assert find_checkpoint("own") == packed
    assert find_checkpoint("runs/own").name == "own"
    assert find_checkpoint("runs/own") != packed
    (tmp_path / "own").write_bytes(np.zeros(3).tobytes())
    assert find_checkpoint("own").resolve() == tmp_path / "own"
    for name in ("last.ckpt", "best.ckpt"):  # of a run's folder the best one, else the last
        (tmp_path / name).touch()
        assert find_checkpoint(tmp_path) == tmp_path / name
    with pytest.raises(FileNotFoundError, match=r"no such checkpoint; .* own"):
        load_checkpoint("tinny")
