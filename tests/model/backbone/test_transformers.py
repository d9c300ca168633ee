import contextlib
import json
import logging

import pytest
import torch
from transformers import ConvNextBackbone, ConvNextConfig

from omniocc.model.backbone import Transformers
from omniocc.model.ops import backbone as pretrained

CONVNEXT = {"depths": [1, 1, 1, 1], "hidden_sizes": [4, 8, 8, 16]}
SWIN = {"embed_dim": 8, "depths": [1, 1, 1, 1], "num_heads": [1, 2, 2, 4], "window_size": 4}
DINO = {"hidden_size": 16, "num_hidden_layers": 2, "num_attention_heads": 2}


def build(architecture="convnext", sizes=CONVNEXT, weights=None, levels=(4, 8, 16, 32)):
    return Transformers(architecture, sizes, weights, channels=5, levels=list(levels))


@pytest.mark.parametrize(("architecture", "sizes"), [("convnext", CONVNEXT), ("swin", SWIN)])
def test_maps_are_finest_first_at_the_given_levels(architecture, sizes):
    images = torch.rand(2, 3, 3, 36, 64)
    maps = build(architecture, sizes)(images)
    assert [level.shape for level in maps] == [(2, 3, 5, 9, 16), (2, 3, 5, 5, 8), (2, 3, 5, 3, 4), (2, 3, 5, 2, 2)]
    assert [level.shape[-1] for level in build(architecture, sizes, levels=[8, 16])(images)] == [8, 4]


def test_a_network_of_one_stride_gives_its_deepest_map():
    backbone = build("dinov2", DINO, levels=[14])
    assert backbone(torch.rand(1, 2, 3, 40, 70))[0].shape == (1, 2, 5, 3, 5)
    assert backbone.stages == [2]


def test_maps_are_aligned_with_the_image(assert_aligned):
    assert_aligned(build(levels=[4]))


@pytest.mark.parametrize(
    ("architecture", "sizes", "levels"),
    [("convnext", CONVNEXT, [4]), ("convnext", CONVNEXT, [16]), ("swin", SWIN, [8]), ("dinov2", DINO, [14])],
)
def test_gradients_reach_exactly_the_parameters_that_train(architecture, sizes, levels):
    backbone = build(architecture, sizes, levels=levels)
    sum(level.square().sum() for level in backbone(torch.rand(2, 1, 3, 32, 64))).backward()
    for name, parameter in backbone.named_parameters():
        assert (parameter.grad is not None) == parameter.requires_grad, name
    assert sum(parameter.requires_grad for parameter in backbone.encoder.parameters()) > 20


def test_probing_changes_neither_running_statistics_nor_training_mode():
    backbone = build("resnet", {"embedding_size": 8, "hidden_sizes": [8, 8, 16, 16], "depths": [1, 1, 1, 1]})
    statistics = {name: value for name, value in backbone.encoder.named_buffers() if name.endswith("running_mean")}
    assert statistics
    assert all(value.abs().max() == 0 for value in statistics.values())
    assert backbone.encoder.training


def test_weights_from_a_folder_are_loaded_and_compared(tmp_path):
    saved = ConvNextBackbone(ConvNextConfig(**CONVNEXT))
    saved.save_pretrained(tmp_path)
    loaded = build(weights=str(tmp_path)).encoder.state_dict()
    shared = [name for name in saved.state_dict() if name in loaded]
    assert len(shared) > 20
    assert all(torch.equal(loaded[name], saved.state_dict()[name]) for name in shared)
    with pytest.raises(ValueError, match=r"depths.*\[1, 1, 1, 1\].*\[1, 1, 2, 1\]"):
        build(sizes={**CONVNEXT, "depths": [1, 1, 2, 1]}, weights=str(tmp_path))
    with pytest.raises(ValueError, match=r"model_type.*convnext.*swin"):
        build("swin", SWIN, weights=str(tmp_path))


def test_code_beside_weights_is_not_run(tmp_path):
    ConvNextBackbone(ConvNextConfig(**CONVNEXT)).save_pretrained(tmp_path)
    (tmp_path / "evil.py").write_text(f"open({str(tmp_path / 'mark')!r}, 'w')\n")
    for facts in ({}, {"model_type": "evil"}):
        config = json.loads((tmp_path / "config.json").read_text()) | {"auto_map": {"AutoConfig": "evil.Evil"}} | facts
        (tmp_path / "config.json").write_text(json.dumps(config))
        with contextlib.suppress(ValueError):
            build(weights=str(tmp_path))
    assert not (tmp_path / "mark").exists()


def test_unavailable_weights_give_one_warning_and_random_weights(monkeypatch, caplog):
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    with caplog.at_level(logging.WARNING, logger=pretrained.__name__):
        build(weights="nobody/no-such-network")
    lines = [record.getMessage() for record in caplog.records if record.name == pretrained.__name__]
    assert len(lines) == 1
    assert "nobody/no-such-network" in lines[0]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"architecture": "convnxt"}, "convnxt.*convnext"),
        ({"sizes": {"depth": [1]}}, r"convnext.*depth.*ConvNextConfig"),
        ({"levels": [2, 4]}, r"levels.*\[2, 4\].*\[4, 8, 16, 32\]"),
    ],
)
def test_mistakes_are_named(options, message):
    with pytest.raises(ValueError, match=message):
        build(**options)
