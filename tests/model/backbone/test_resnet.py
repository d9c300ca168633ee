import logging
import time

import pytest
import torch
from transformers import ResNetConfig, ResNetModel

from omniocc.errors import UserError
from omniocc.model.backbone import ResNet
from omniocc.model.ops.backbone import pretrained

SIZES = {"layer_type": "basic", "embedding_size": 8, "hidden_sizes": [8, 8, 16, 16], "depths": [1, 1, 1, 1]}


def build(weights=None, levels=(4, 8, 16, 32)):
    return ResNet(**SIZES, weights=weights, channels=5, levels=list(levels))


@pytest.mark.parametrize("height", [32, 36])
def test_maps_are_finest_first_at_the_given_levels(height):
    maps = build()(torch.rand(2, 3, 3, height, 64))
    assert [level.shape[:3] for level in maps] == [(2, 3, 5)] * 4
    assert [level.shape[-1] for level in maps] == [16, 8, 4, 2]
    assert [level.shape for level in build(levels=[8, 16])(torch.rand(1, 1, 3, 32, 64))] == [
        (1, 1, 5, 4, 8),
        (1, 1, 5, 2, 4),
    ]


def test_images_are_normalised_with_the_statistics_of_imagenet():
    backbone = build().eval()
    mean_image = torch.tensor([0.485, 0.456, 0.406]).view(1, 1, 3, 1, 1).expand(1, 1, 3, 32, 32)
    seen = []
    backbone.encoder.register_forward_pre_hook(lambda _, arguments: seen.append(arguments[0]))
    backbone(mean_image)
    torch.testing.assert_close(seen[0], torch.zeros_like(seen[0]))


@pytest.mark.parametrize(("narrowest", "layout"), [(8, torch.contiguous_format), (16, torch.channels_last)])
def test_images_of_narrow_networks_are_not_channels_last(narrowest, layout):
    """Gradients of maps this large end the process where they are, on a CPU with AVX-512 and torch 2.13."""
    sizes = SIZES | {"embedding_size": narrowest, "hidden_sizes": [narrowest, 16, 16, 16]}
    backbone = ResNet(**sizes, weights=None, channels=5, levels=[4, 8])
    seen = []
    backbone.encoder.register_forward_pre_hook(lambda _, arguments: seen.append(arguments[0]))
    sum(level.sum() for level in backbone(torch.rand(1, 2, 3, 144, 256))).backward()
    assert seen[0].is_contiguous(memory_format=layout)


def test_unknown_levels_are_named():
    with pytest.raises(ValueError, match=r"levels are \[4, 6\]"):
        build(levels=[4, 6])


@pytest.mark.parametrize("levels", [[16, 8], [8, 8]])
def test_levels_in_another_order_are_named(levels):
    with pytest.raises(ValueError, match=r"give each stride once, finest first: \[8"):
        build(levels=levels)


def test_weights_from_a_folder_are_loaded(tmp_path):
    saved = ResNetModel(ResNetConfig(**SIZES))
    saved.save_pretrained(tmp_path)
    loaded = build(str(tmp_path)).encoder.state_dict()
    assert all(torch.equal(loaded[name], value) for name, value in saved.state_dict().items())


def test_weights_of_another_size_are_refused(tmp_path):
    ResNetModel(ResNetConfig(**{**SIZES, "depths": [1, 1, 1, 2]})).save_pretrained(tmp_path)
    with pytest.raises(ValueError, match=r"depths.*\[1, 1, 1, 2\].*\[1, 1, 1, 1\]"):
        build(str(tmp_path))


@pytest.mark.parametrize("offline", [True, False])
def test_unavailable_weights_give_one_warning_and_random_weights(monkeypatch, caplog, tmp_path, offline):
    monkeypatch.setenv("HF_HUB_OFFLINE", "1" if offline else "0")
    monkeypatch.setenv("HF_ENDPOINT", "http://127.0.0.1:9")
    started = time.monotonic()
    with caplog.at_level(logging.WARNING, logger=pretrained.__name__):
        backbone = build("nobody/no-such-network")
    assert time.monotonic() - started < 10
    lines = [record.getMessage() for record in caplog.records if record.name == pretrained.__name__]
    assert len(lines) == 1
    assert "nobody/no-such-network" in lines[0]
    assert "\n" not in lines[0]
    assert len(backbone(torch.rand(1, 2, 3, 32, 64))) == 4


def test_building_without_weights_never_asks_the_network(monkeypatch):
    def refuse(*arguments, **options):
        raise AssertionError("network access")

    monkeypatch.setattr("socket.socket.connect", refuse)
    build()


@pytest.mark.parametrize("name", ["weights.pt", "folder"])
def test_a_file_or_folder_that_cannot_be_loaded_is_no_reason_for_random_weights(name, tmp_path):
    (tmp_path / "folder").mkdir()
    with pytest.raises(UserError, match=rf"weights=.*{name} cannot be loaded; give a folder that"):
        build(str(tmp_path / name))
