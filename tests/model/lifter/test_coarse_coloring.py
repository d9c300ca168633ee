import pytest
import torch

from omniocc.geometry import Cuboid, Cylinder
from omniocc.model.lifter import CoarseColoring, Coloring
from omniocc.model.sketch import Sketched

SIZES = {"layers": 1, "heads": 2, "points": 2, "feedforward_channels": 8}


def make(geometry, block=2):
    return CoarseColoring(geometry, 8, [4], block=block, **SIZES).double()


def make_features():
    return [torch.randn(1, 6, 8, 9, 16, dtype=torch.float64)]


@torch.no_grad()
@pytest.mark.parametrize(
    ("fine", "coarse"),
    [(Cylinder((4, 8, 4)), Cylinder((2, 4, 2))), (Cuboid((6, 4, 4)), Cuboid((3, 2, 2)))],
    ids=["cylinder", "cuboid"],
)
def test_every_voxel_has_the_feature_of_its_block(fisheye, fine, coarse):
    lifter, features = make(fine), make_features()
    coloring = Coloring(coarse, 8, [4], **SIZES).double()
    coloring.load_state_dict(lifter.coloring.state_dict())
    blocks = torch.rand(1, *coarse.shape) < 0.5
    candidates = torch.zeros(1, *fine.shape, dtype=torch.bool)
    candidates[:, ::2, 1::2, ::2] = blocks  # one voxel of each
    expected = coloring(features, Sketched(blocks), (fisheye,))
    volume = lifter(features, Sketched(candidates), (fisheye,))
    for x, y, z in torch.cartesian_prod(*[torch.arange(2)] * 3).tolist():
        assert torch.equal(volume[:, :, x::2, y::2, z::2], expected)


def test_training_reaches_every_parameter(fisheye):
    geometry = Cuboid((4, 4, 4))
    lifter = make(geometry)
    candidates = torch.zeros(1, *geometry.shape, dtype=torch.bool)
    candidates[0, :2] = True
    volume = lifter(make_features(), Sketched(candidates), (fisheye,))
    (volume * torch.randn_like(volume)).sum().backward()
    for name, parameter in lifter.named_parameters():
        assert parameter.grad.abs().sum() > 0, name


def test_a_grid_that_does_not_divide_is_named():
    with pytest.raises(ValueError, match=r"4x8x3.*divide"):
        make(Cylinder((4, 8, 3)))
