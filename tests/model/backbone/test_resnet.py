import copy
import logging
import math
import sys
import time

import pytest
import torch
from torch import nn
from transformers import ResNetConfig, ResNetModel

from omniocc.errors import UserError
from omniocc.model.backbone import ResNet
from omniocc.model.backbone import resnet as deformable
from omniocc.model.backbone.resnet import OPERATORS, DeformableConv2d
from omniocc.model.ops import backbone as pretrained

SIZES = {"layer_type": "basic", "embedding_size": 8, "hidden_sizes": [8, 8, 16, 16], "depths": [1, 1, 1, 1]}
NETWORK = {"layer_type": "bottleneck", "embedding_size": 8, "hidden_sizes": [8, 8, 16, 16], "depths": [1, 1, 1, 2]}


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


def pixel(maps, row, column):
    """(C,) by bilinear interpolation, zeros outside; differentiable in row and column."""
    total = torch.zeros(len(maps), dtype=maps.dtype)
    for r in (math.floor(row.detach()), math.floor(row.detach()) + 1):
        for c in (math.floor(column.detach()), math.floor(column.detach()) + 1):
            if 0 <= r < maps.shape[1] and 0 <= c < maps.shape[2]:
                total = total + (1 - (row - r).abs()) * (1 - (column - c).abs()) * maps[:, r, c]
    return total


def convolve_by_loops(maps, weight, offsets, mask, stride, padding):
    """y(p) = sum over taps k of w_k * x(p + p_k + offset_k) * mask_k, a number at a time."""
    images = []
    for image, offset, factor in zip(maps, offsets, mask, strict=True):
        rows = []
        for v in range(offset.shape[1]):
            for u in range(offset.shape[2]):
                total = torch.zeros(len(weight), dtype=maps.dtype)
                for tap in range(factor.shape[0]):
                    k, m = divmod(tap, weight.shape[3])
                    row = v * stride[0] - padding[0] + k + offset[2 * tap, v, u]
                    column = u * stride[1] - padding[1] + m + offset[2 * tap + 1, v, u]
                    total = total + weight[:, :, k, m] @ pixel(image, row, column) * factor[tap, v, u]
                rows.append(total)
        images.append(torch.stack(rows, dim=1).view(-1, *offset.shape[1:]))
    return torch.stack(images)


@pytest.mark.parametrize("operator", OPERATORS)
@pytest.mark.parametrize(("stride", "padding", "size"), [((1, 1), (1, 1), (5, 6)), ((2, 1), (0, 2), (2, 8))])
def test_values_and_gradients_are_those_of_loops(operator, assert_same_gradients, stride, padding, size):
    maps = torch.randn(2, 3, 5, 6, dtype=torch.float64)
    weight = torch.randn(4, 3, 3, 3, dtype=torch.float64)
    offsets = torch.randn(2, 18, *size, dtype=torch.float64) * 2
    mask = torch.rand(2, 9, *size, dtype=torch.float64) * 2
    tensors = [tensor.requires_grad_() for tensor in (maps, weight, offsets, mask)]
    result, expected = operator(*tensors, stride, padding), convolve_by_loops(*tensors, stride, padding)
    assert_same_gradients(result, expected, tensors)
    single = operator(*(tensor.detach().float() for tensor in tensors), stride, padding)
    torch.testing.assert_close(single.double(), expected, atol=1e-5, rtol=1e-5)


@pytest.mark.parametrize("stride", [1, 2])
def test_starts_equal_to_the_ordinary_convolution(stride):
    conv = nn.Conv2d(3, 4, 3, stride, 1, bias=False).double()
    maps = torch.randn(2, 3, 7, 8, dtype=torch.float64)
    expected = conv(maps)
    layer = DeformableConv2d(conv).double()
    assert layer.weight is conv.weight
    torch.testing.assert_close(layer(maps), expected)
    layer(maps).square().sum().backward()
    for name, parameter in layer.named_parameters():
        assert parameter.grad.abs().sum() > 0, name


def test_offsets_move_and_factors_scale_the_samples():
    layer = DeformableConv2d(nn.Conv2d(1, 1, 3, 1, 1, bias=False)).double()
    nn.init.zeros_(layer.weight)
    layer.weight.data[0, 0, 1, 1] = 1.0  # the middle tap alone
    maps = torch.arange(20.0, dtype=torch.float64).view(1, 1, 4, 5)
    layer.taps.bias.data[8:10] = torch.tensor([1.0, -0.5])  # one row down, half a column left
    layer.taps.bias.data[18 + 4] = math.log(0.75 / 0.25)  # 2 * 0.75
    assert layer(maps)[0, 0, 1, 1:].tolist() == pytest.approx([1.5 * 10.5, 1.5 * 11.5, 1.5 * 12.5, 1.5 * 13.5])
    assert layer(maps)[0, 0, 3].abs().max() == 0


def test_a_convolution_with_groups_is_refused():
    with pytest.raises(ValueError, match="cannot be made deformable"):
        DeformableConv2d(nn.Conv2d(4, 4, 3, groups=2, bias=False))


def test_stages_three_and_four_become_deformable_and_keep_loaded_weights(tmp_path):
    saved = ResNetModel(ResNetConfig(**NETWORK))
    saved.save_pretrained(tmp_path)
    plain = ResNet(**NETWORK, weights=str(tmp_path), channels=5, levels=[8, 16]).eval()
    backbone = ResNet(**NETWORK, weights=str(tmp_path), channels=5, levels=[8, 16], deformable_stages=[3, 4]).eval()
    replaced = [name for name, layer in backbone.encoder.named_modules() if isinstance(layer, DeformableConv2d)]
    assert [name.split(".")[2] for name in replaced] == ["2", "3", "3"]
    loaded = backbone.encoder.state_dict()
    assert all(torch.equal(loaded[name], value) for name, value in saved.state_dict().items())
    backbone.fpn = copy.deepcopy(plain.fpn)
    images = torch.rand(1, 2, 3, 36, 64)
    for ours, expected in zip(backbone(images), plain(images), strict=True):
        torch.testing.assert_close(ours, expected, atol=1e-5, rtol=1e-5)


def test_unknown_stages_are_named():
    with pytest.raises(ValueError, match=r"deformable_stages are \[5\]"):
        ResNet(**NETWORK, weights=None, channels=5, levels=[8], deformable_stages=[5])


def test_a_torchvision_built_for_another_torch_is_named_and_left_out(monkeypatch, caplog, tmp_path):
    package = tmp_path / "torchvision"
    package.mkdir()
    (package / "__init__.py").write_text("raise RuntimeError('operator torchvision::nms does not exist')")
    for name in [name for name in sys.modules if name.split(".")[0] == "torchvision"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.syspath_prepend(tmp_path)
    with caplog.at_level(logging.WARNING, logger=deformable.__name__):
        assert deformable._torchvision() is None
    assert "torchvision::nms does not exist" in caplog.text
