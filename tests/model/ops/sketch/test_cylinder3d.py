import pytest
import torch
from torch.nn import functional as F

from omniocc.geometry import Cuboid, Cylinder
from omniocc.model.ops.padding import Conv3d
from omniocc.model.ops.sketch.cylinder3d import Asymmetric, Context, Cylinder3D

GRID = Cylinder((8, 12, 4))


def test_convolution_wraps_around_and_pads_with_zeros():
    conv = Conv3d(3, 5, (3, 5, 1), GRID.periodic)
    volume = torch.randn(2, 3, 8, 12, 4)
    repeated = torch.cat([volume] * 3, dim=3)
    expected = F.conv3d(repeated, conv.weight, conv.bias, padding=(1, 0, 0))[:, :, :, 10:22]
    assert torch.allclose(conv(volume), expected, atol=1e-5)


def test_rolling_by_the_stride_rolls_the_output():
    network = Cylinder3D(GRID, 3, [8, 16, 16], 2)
    volume = torch.randn(1, 3, 8, 12, 4)
    for cells in (4, 8):
        assert torch.allclose(network(volume.roll(cells, 3)), network(volume).roll(cells, 3), atol=1e-5)
    assert not torch.allclose(network(volume.roll(4, 2)), network(volume).roll(4, 2), atol=1e-3)


def test_a_batch_of_two_is_two_batches_of_one(geometry):
    network = Cylinder3D(geometry, 3, [8, 8], 2)
    volume = torch.randn(2, 3, *geometry.shape)
    assert torch.allclose(network(volume), torch.cat([network(volume[:1]), network(volume[1:])]), atol=1e-5)


def test_gradients_reach_every_parameter(geometry):
    network = Cylinder3D(geometry, 3, [8, 16, 16], 2)
    network(torch.randn(1, 3, *geometry.shape)).square().sum().backward()
    for name, parameter in network.named_parameters():
        assert parameter.grad is not None, name
        assert parameter.grad.any(), name


def test_blocks_reach_as_far_as_their_kernels_say():
    def reach(block):
        for module in block.modules():  # the norm depends on the whole sample
            if isinstance(module, torch.nn.GroupNorm):
                module.forward = lambda volume: volume
        volume = torch.randn(1, 8, *GRID.shape, requires_grad=True)
        block(volume)[0, :, 4, 6, 2].sum().backward()
        touched = volume.grad.abs().sum((0, 1)).nonzero() - torch.tensor([4, 6, 2])
        return {tuple(cell) for cell in touched.tolist()}

    box = {(x, y, z) for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-2, -1, 0, 1)}  # z ends at +1
    assert reach(Asymmetric(8, 8, GRID.periodic)) == box
    cross = {(0, 0, 0)} | {tuple(step * (i == axis) for i in range(3)) for axis in range(3) for step in (-1, 1)}
    assert reach(Context(8, GRID.periodic)) == cross


def test_context_against_its_formula():
    context = Context(8, GRID.periodic)
    volume = torch.randn(2, 8, *GRID.shape)
    gates = [torch.sigmoid(norm(conv(volume))) for conv, norm in zip(context.convs, context.norms, strict=True)]
    assert torch.allclose(context(volume), volume * (gates[0] + gates[1] + gates[2]), atol=1e-6)


@pytest.mark.parametrize("shape", [(7, 12, 3), (5, 8, 1)])
def test_other_axes_may_be_odd(shape):
    assert Cylinder3D(Cylinder(shape), 3, [8, 8, 8], 2)(torch.randn(1, 3, *shape)).shape == (1, 2, *shape)
    assert Cylinder3D(Cuboid(shape), 3, [8, 8, 8], 2)(torch.randn(1, 3, *shape)).shape == (1, 2, *shape)


def test_impossible_sizes_are_named():
    with pytest.raises(ValueError, match=r"multiples of 8.* 12"):
        Cylinder3D(GRID, 3, [8, 8, 8, 8], 2)
    with pytest.raises(ValueError, match="12 channels"):
        Cylinder3D(GRID, 3, [12, 8], 2)
