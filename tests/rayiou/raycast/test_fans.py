import pytest
import torch

from omniocc.geometry import RayScan
from omniocc.metric import sparseocc_directions


def rays_of(fans):
    """Return origin and unit direction of every ray, from its fan."""
    count, azimuths = fans.azimuths.shape[:2]
    elevations = fans.slopes.shape[1]
    k = torch.arange(count).repeat_interleave(azimuths * elevations)
    place = fans.order.argsort().repeat(count)
    a, e = place // elevations, place % elevations
    flat = torch.cat([fans.azimuths[k, a], fans.slopes[k, e].unsqueeze(1)], dim=1)
    return fans.origins[k], flat / fans.stretches[k, e].unsqueeze(1), count


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_the_public_rays_are_a_raster_in_any_order(dtype):
    directions = sparseocc_directions()[torch.randperm(14040, generator=torch.Generator().manual_seed(0))]
    scan = RayScan(3 * directions.to(dtype))
    origins = torch.tensor([[0.0, 0.0, 0.0], [1.0, 2.0, 3.0]])
    fans = scan.fans(origins)
    assert fans.azimuths.shape == (2, 360, 2)
    assert fans.slopes.shape == (2, 39)
    start, unit, _ = rays_of(fans)
    expected_start, expected_unit = scan.rays(origins)
    assert torch.equal(start, expected_start)
    torch.testing.assert_close(unit, expected_unit, rtol=0, atol=1e-15)
    # float32 directions move by no more than their rounding
    worst = (scan.directions - directions).abs().max().item()
    assert worst < (2e-7 if dtype == torch.float32 else 1e-15)


def test_azimuths_on_both_sides_of_the_seam_are_equal():
    azimuth = torch.tensor([[-1.0, 1e-17], [-1.0, -1e-17], [0.0, 1.0], [0.0, 1.0]], dtype=torch.float64)
    directions = torch.cat([azimuth, torch.tensor([[0.1], [0.5], [0.1], [0.5]])], dim=1)
    scan = RayScan(directions)
    assert scan.raster is not None
    assert scan.raster.azimuths.shape == (2, 2)


@pytest.mark.parametrize(
    "directions",
    [
        torch.randn(50, 3, generator=torch.Generator().manual_seed(0)),
        sparseocc_directions()[:-1],
        torch.cat([sparseocc_directions(), sparseocc_directions()[:1]]),
        torch.tensor([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]]),
    ],
)
def test_other_directions_are_fans_of_one_ray(directions):
    scan = RayScan(directions)
    assert scan.raster is None
    start, unit, count = rays_of(scan.fans(torch.ones(2, 3)))
    assert count == 2 * len(directions)
    torch.testing.assert_close(unit, scan.rays(torch.ones(2, 3))[1])
    assert (start == 1).all()


@pytest.mark.parametrize("bad", [[0.0, 0.0, 0.0], [1.0, float("nan"), 0.0], [float("inf"), 0.0, 0.0]])
def test_directions_without_length_are_refused(bad):
    with pytest.raises(ValueError, match=r"directions.*finite"):
        RayScan(torch.tensor([[1.0, 0.0, 0.0], bad]))
