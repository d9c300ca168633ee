import pytest
import torch

from omniocc.model.ops.depth.layers import FeatureNet
from omniocc.model.ops.efficientnet import LAST, FrozenLite0, encoder_with


def test_maps_of_all_levels_have_the_size_of_their_stride_and_the_coarsest_of_the_network():
    frozen = FrozenLite0(None)
    images = torch.rand(2, 3, 3, 34, 62)
    for levels in (1, 2, 3):
        maps = frozen(images, levels)
        assert [found.shape[1] for found in maps] == frozen.channels(levels)
        assert frozen.channels(levels)[-1] == list(LAST.values())[levels - 1] + LAST[16]
        sizes = [(-(-34 // stride), -(-62 // stride)) for stride in (2, 4, 8)[:levels]]
        assert [tuple(found.shape[2:]) for found in maps] == sizes
    with pytest.raises(ValueError, match="4 levels"):
        frozen.channels(4)


def test_frozen_features_never_change_and_get_no_gradient():
    frozen = FrozenLite0(None).train()
    before = {name: value.clone() for name, value in frozen.state_dict().items()}
    network = FeatureNet([8, 16], 4, pretrained=frozen).train()

    network(torch.rand(2, 1, 3, 16, 32)).sum().backward()

    assert all(torch.equal(value, before[name]) for name, value in frozen.state_dict().items())
    assert not any(parameter.requires_grad for parameter in frozen.parameters())
    assert all(parameter.grad is not None for parameter in network.added.parameters())


def test_features_without_them_are_what_they_were():
    torch.manual_seed(0)
    plain = FeatureNet([8, 16], 4)
    torch.manual_seed(0)
    other = FeatureNet([8, 16], 4, pretrained=FrozenLite0(None))
    for add in other.added:
        torch.nn.init.zeros_(add[1].weight)
    other.load_state_dict(plain.state_dict(), strict=False)
    images = torch.rand(1, 2, 3, 16, 32)

    assert torch.equal(plain(images), other(images))


@torch.no_grad()
def test_a_frozen_network_computes_what_it_did_also_after_loading_and_converting():
    torch.manual_seed(1)
    plain, images = encoder_with(None).eval(), torch.randn(2, 3, 32, 64)
    frozen = FrozenLite0(None).encoder
    assert frozen.state_dict().keys() == plain.state_dict().keys()

    for name, value in plain.state_dict().items():
        if "norm" in name and value.is_floating_point():
            value.copy_(0.5 + torch.rand_like(value))
    frozen.load_state_dict(plain.state_dict())
    for own, other in zip(frozen(images), plain(images), strict=True):
        torch.testing.assert_close(own, other, rtol=1e-4, atol=1e-4 * float(other.abs().max()))

    for own, other in zip(frozen.double()(images.double()), plain.double()(images.double()), strict=True):
        torch.testing.assert_close(own, other, rtol=1e-10, atol=1e-10 * float(other.abs().max()))
