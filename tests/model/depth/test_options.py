"""The contract of every option of the depth slot."""

from dataclasses import replace

import pytest
import torch

from omniocc.model import depth
from omniocc.model.depth import Depth, LearnedDepth, learns

NETS = ["OmniMVS", "OmniMVS3D"]
BLIND = ["Sweep", "Mono", *NETS]
every = pytest.mark.parametrize("name", BLIND)


def images_of(rigs, seed=0):
    torch.manual_seed(seed)
    return torch.rand(len(rigs), len(rigs[0].cameras), 3, 36, 64)


def targets(rigs):
    torch.manual_seed(1)
    erp_m = 2 + 20 * torch.rand(len(rigs), 12, 48)
    camera_m = 2 + 20 * torch.rand(len(rigs), len(rigs[0].cameras), 36, 64)
    erp_m[:, :3], camera_m[:, :, :9] = float("inf"), float("inf")
    camera_m[:, :, -4:] = float("nan")
    return erp_m, camera_m


def assert_depth(depth, samples):
    assert depth.range_m.shape == depth.index.shape == depth.valid.shape == depth.confidence.shape == (samples, 12, 48)
    assert depth.range_m.isfinite().all()
    assert (depth.range_m > 0).all()
    assert ((depth.index >= 0) & (depth.index <= 7)).all()
    assert ((depth.confidence >= 0) & (depth.confidence <= 1)).all()
    assert depth.valid.dtype == torch.bool


@every
def test_contract(name, small, rig):
    model = small(name)
    assert isinstance(model, Depth)
    assert (model.panorama.width, model.panorama.height) == (48, 12)
    assert_depth(model(images_of((rig, rig)), (rig, rig)), 2)


@pytest.mark.parametrize("name", ["Truth", *BLIND])
def test_the_class_shows_whether_it_learns_and_needs_the_true_range(name, small):
    option = getattr(depth, name)
    assert learns(option) == (name in ("Mono", *NETS))
    assert isinstance(small(name), LearnedDepth) == learns(option)
    assert (name == "Truth") == option.NEEDS_TRUE_RANGE


@every
def test_a_rig_of_cameras_of_two_sizes(name, small, rig):
    cameras = tuple(replace(camera, width=48, height=32) if k % 2 else camera for k, camera in enumerate(rig.cameras))
    assert_depth(small(name)(images_of((rig,)), (replace(rig, cameras=cameras),)), 1)


@every
def test_samples_of_different_rigs_do_not_mix(name, small, rig, make_ring):
    other = make_ring(6, radius_m=1.2)
    rigs = (rig, other, rig)
    images, model = images_of(rigs), small(name).eval()
    with torch.no_grad():
        together = model(images, rigs)
        for k, own in enumerate(rigs):
            single = model(images[k : k + 1], (own,))
            for ours, expected in zip(together, single, strict=True):
                torch.testing.assert_close(ours[k].float(), expected[0].float(), atol=1e-3, rtol=1e-3)


@every
@pytest.mark.parametrize("count", [1, 2, 5])
def test_any_number_of_cameras(name, count, small, make_ring):
    few = make_ring(count)
    assert_depth(small(name)(images_of((few,)), (few,)), 1)


@every
def test_a_black_image_and_a_masked_camera_change_only_their_part(name, small, rig):
    images = images_of((rig,))
    images[0, 2] = 0
    blind = torch.zeros(36, 64, dtype=torch.bool)
    masked = replace(rig, masks=(None, None, blind, None, None, None))
    model = small(name).eval()
    with torch.no_grad():
        assert_depth(model(images, (rig,)), 1)
        dark, hidden = model(images, (rig,)), model(images, (masked,))
    assert_depth(hidden, 1)
    assert (dark.valid == hidden.valid).float().mean() > 0.9
    all_black = model(torch.zeros_like(images), (rig,))
    assert_depth(all_black, 1)
    assert not all_black.valid.any()


@every
def test_wrong_images_are_named(name, small, rig, make_ring):
    model, images = small(name), images_of((rig,))
    with pytest.raises(ValueError, match=r"6 cameras.*images.* 5"):
        model(images[:, :5], (rig,))
    with pytest.raises(ValueError, match=r"rig.*64x36.*32x36 px"):
        model(images[..., :32], (rig,))
    with pytest.raises(ValueError, match=r"2 rigs.* 1 sample"):
        model(images, (rig, rig))
    images[0, 0, 0, 0, 0] = float("nan")
    with pytest.raises(ValueError, match="NaN"):
        model(images, (rig,))


def drawing(flip):
    """Return a generator whose next draw does or does not mirror the batch."""
    for seed in range(100):
        if (torch.rand((), generator=torch.Generator().manual_seed(seed)) < 0.5) == flip:
            return torch.Generator().manual_seed(seed)
    raise AssertionError("no seed below 100 draws this")


@pytest.mark.parametrize("name", ["Mono", *NETS])
def test_mirroring_follows_the_generator_and_not_the_global_state(name, small, rig):
    model, images, (erp_m, camera_m) = small(name, mirror=True), images_of((rig,)), targets((rig,))

    def terms(flip, global_seed):
        torch.manual_seed(global_seed)
        with torch.no_grad():
            return model.weighted_losses(images, (rig,), erp_m, camera_m, drawing(flip))

    assert terms(True, 0) == terms(True, 1)
    assert terms(False, 0) == terms(False, 1)
    assert terms(True, 0) != terms(False, 0)


@pytest.mark.parametrize("name", ["Mono", *NETS])
@pytest.mark.parametrize("flip", [False, True])
def test_every_parameter_learns(name, flip, small, rig):
    model, rigs = small(name, mirror=True), (rig, rig)
    images, (erp_m, camera_m) = images_of(rigs), targets(rigs)
    terms = model.weighted_losses(images, rigs, erp_m, camera_m, drawing(flip))
    sum(terms.values()).backward()
    assert all(term.ndim == 0 and term.isfinite() for term in terms.values())
    silent = [key for key, value in model.named_parameters() if value.grad is None or not value.grad.any()]
    assert silent == []


@pytest.mark.parametrize("name", NETS)
def test_losses_of_a_mixed_batch_are_means_over_samples(name, small, rig, make_ring):
    rigs = (rig, make_ring(6, radius_m=1.2), rig)
    images, model, (erp_m, camera_m) = images_of(rigs), small(name), targets(rigs)
    with torch.no_grad():
        together = model.weighted_losses(images, rigs, erp_m, camera_m, drawing(flip=False))
        single = [
            model.weighted_losses(
                images[k : k + 1], rigs[k : k + 1], erp_m[k : k + 1], camera_m[k : k + 1], drawing(flip=False)
            )
            for k in range(3)
        ]
    for key in ("index", "spheres"):
        expected = sum(terms[key] for terms in single) / 3
        torch.testing.assert_close(together[key], expected, atol=1e-4, rtol=1e-3)


@pytest.mark.parametrize("name", ["Mono", *NETS])
def test_training_reduces_the_error(name, small, rig):
    model, images, (erp_m, camera_m) = small(name), images_of((rig,)), targets((rig,))
    erp_m[:, 3:], camera_m[:, :, 9:-4] = 6.0, 6.0
    optimizer = torch.optim.Adam(model.parameters(), lr=1e-2)
    losses, generator = [], torch.Generator().manual_seed(0)
    for _ in range(15):
        loss = sum(model.weighted_losses(images, (rig,), erp_m, camera_m, generator).values())
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(loss.item())
    assert losses[-1] < 0.6 * losses[0]
