import pytest
import torch

from omniocc.geometry import Cuboid, Cylinder
from omniocc.model.lifter import LiftSplat
from omniocc.model.lifter.lift_splat import find_entries, splat
from omniocc.model.sketch import Sketched

GRID = Cylinder((4, 8, 3))
CANDIDATES = torch.ones(2, *GRID.shape, dtype=torch.bool)


def make(geometry=GRID, bins=6, levels=(4, 8)):
    return LiftSplat(geometry, in_channels=8, channels=5, levels=list(levels), bins=bins, range_m=(0.5, 24.5)).double()


@pytest.mark.parametrize("geometry", [GRID, Cuboid((6, 5, 3))], ids=["cylinder", "cuboid"])
def test_probabilities_of_a_pixel_sum_to_one_over_bins_of_equal_size(fisheye, geometry):
    lifter, features = make(geometry, levels=[8]), torch.randn(1, 6, 8, 5, 8, dtype=torch.float64)
    pixels = features[0].permute(0, 2, 3, 1).reshape(-1, 8)
    weight, bias = lifter.split.weight, lifter.split.bias
    scores = pixels @ weight[:6].T + bias[:6]
    probability = scores.exp() / scores.exp().sum(-1, keepdim=True)
    entries = find_entries(fisheye, geometry, 5, 8, (2.5, 6.5, 10.5, 14.5, 18.5, 22.5), torch.device("cpu"))
    expected = splat(pixels @ weight[6:].T + bias[6:], probability, entries)
    volume = lifter([features], Sketched(torch.ones(1, *geometry.shape, dtype=torch.bool)), (fisheye,))
    torch.testing.assert_close(volume[0].flatten(1).T, expected)


@torch.no_grad()
def test_batch_with_different_rigs_equals_single_samples(fisheye, pinhole):
    lifter, features = make(), [torch.randn(2, 6, 8, *size, dtype=torch.float64) for size in ((9, 16), (5, 8))]
    both = lifter(features, Sketched(CANDIDATES), (fisheye, pinhole))
    for index, rig in enumerate((fisheye, pinhole)):
        alone = lifter([level[index : index + 1] for level in features], Sketched(CANDIDATES[:1]), (rig,))
        torch.testing.assert_close(both[index], alone[0])
    assert not torch.allclose(both[0], both[1])


@torch.no_grad()
def test_finer_maps_are_averaged_onto_the_coarsest(make_ring):
    lifter, fisheye = make(), make_ring(6, 48, 32)
    fine, coarse = torch.randn(1, 6, 8, 8, 12, dtype=torch.float64), torch.randn(1, 6, 8, 4, 6, dtype=torch.float64)
    means = fine.unflatten(-1, (6, 2)).unflatten(-3, (4, 2)).mean((-1, -3))
    single = make(levels=[8])
    single.load_state_dict(lifter.state_dict())
    expected = single([means + coarse], Sketched(CANDIDATES[:1]), (fisheye,))
    torch.testing.assert_close(lifter([fine, coarse], Sketched(CANDIDATES[:1]), (fisheye,)), expected)


def test_training_reaches_every_parameter_and_every_map(make_ring):
    lifter, fisheye = make(), make_ring(6, 48, 32)
    features = [torch.randn(2, 6, 8, *size, dtype=torch.float64, requires_grad=True) for size in ((8, 12), (4, 6))]
    lifter(features, Sketched(CANDIDATES), (fisheye, fisheye)).square().sum().backward()
    for tensor in (*features, *lifter.parameters()):
        assert tensor.grad.abs().sum() > 0


def test_bfloat16_keeps_probabilities_in_single_precision(fisheye):
    lifter, features = make(levels=[8]).float(), [torch.randn(1, 6, 8, 5, 8)]
    with torch.autocast("cpu", dtype=torch.bfloat16):
        volume = lifter(features, Sketched(CANDIDATES[:1]), (fisheye,))
    assert volume.dtype == torch.float32
    assert torch.equal(volume, lifter(features, Sketched(CANDIDATES[:1]), (fisheye,)))


def test_a_rig_with_other_cameras_than_the_images_is_named(fisheye):
    with pytest.raises(ValueError, match=r"6 cameras.*images.* 4"):
        make(levels=[8])([torch.randn(1, 4, 8, 5, 8, dtype=torch.float64)], Sketched(CANDIDATES[:1]), (fisheye,))


def test_bins_and_ranges_are_checked():
    with pytest.raises(ValueError, match="bins is 0"):
        make(bins=0)
    with pytest.raises(ValueError, match=r"range_m is \[5.0, 1.0\]"):
        LiftSplat(GRID, 8, 8, [4], 3, [5.0, 1.0])


def test_range_logits_are_the_scores_that_weight_the_features(make_ring):
    lifter, fisheye = make(), make_ring(6, 48, 32)
    features = [torch.randn(1, 6, 8, *size, dtype=torch.float64) for size in ((8, 12), (4, 6))]
    logits = lifter.range_logits(features)
    assert logits.shape == (1, 6, 6, 4, 6)
    seen = []
    lifter.split.register_forward_hook(lambda layer, inputs, output: seen.append(output))
    lifter(features, Sketched(CANDIDATES[:1]), (fisheye,))
    torch.testing.assert_close(logits.movedim(2, -1).flatten(1, 3), seen[0][..., :6])
