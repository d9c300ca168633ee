import pytest
import torch

from omniocc.geometry import Cuboid, Cylinder
from omniocc.model.refiner import UNet
from omniocc.model.sketch import Sketched

SKETCHED = Sketched(torch.ones(1, 1, 1, 1, dtype=torch.bool))


@pytest.mark.parametrize("roll", [4, 8])
@pytest.mark.parametrize("cells", [100, 200])
def test_rotating_the_world_rotates_the_answer(roll, cells):
    unet = UNet(Cylinder((6, cells, 8)), 3, [8, 8, 16]).double()
    volume = torch.randn(1, 3, 6, cells, 8, dtype=torch.float64)
    refined = unet(volume, SKETCHED)
    assert refined.shape == (1, 8, 6, cells, 8)
    torch.testing.assert_close(unet(volume.roll(roll, dims=3), SKETCHED), refined.roll(roll, dims=3))


def test_odd_sizes_without_wrap_keep_their_shape():
    assert UNet(Cuboid((5, 7, 3)), 3, [8, 8, 8])(torch.randn(2, 3, 5, 7, 3), SKETCHED).shape == (2, 8, 5, 7, 3)


def test_every_voxel_sees_beyond_its_neighbours():
    unet = UNet(Cylinder((16, 16, 4)), 1, [8, 8, 8]).double()
    volume = torch.randn(1, 1, 16, 16, 4, dtype=torch.float64, requires_grad=True)
    unet(volume, SKETCHED)[0, 0, 8, 0, 2].backward()
    reach = volume.grad[0, 0, 8, :, 2].abs()
    assert reach[15] > 0  # across the seam
    assert reach[5] > 0


def test_an_azimuth_that_cannot_be_halved_is_named():
    with pytest.raises(ValueError, match=r"multiples of 4.* 10"):
        UNet(Cylinder((8, 10, 4)), 3, [8, 8, 8])


def test_channels_must_split_into_groups():
    with pytest.raises(ValueError, match="12 channels"):
        UNet(Cylinder((8, 12, 4)), 3, [8, 12])
