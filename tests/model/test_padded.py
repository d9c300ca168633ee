"""A batch of a rig of six cameras of 64x36 px and one of four of 48x32 px, padded, against single samples."""

import pytest
import torch

from omniocc.camera import Rig
from omniocc.config import build
from omniocc.geometry import Cylinder
from omniocc.model.lifter import CoarseColoring, Coloring, LiftSplat, Pillar
from omniocc.model.ops.padded import crop
from omniocc.model.sketch import Sketched

GRID = Cylinder((4, 8, 4))
LEVELS = [4, 8]


@pytest.fixture
def rigs(make_ring):
    return make_ring(6), make_ring(4, 48, 32)


PRETRAINED = "omnimvs depth.pretrained=true depth.weights=null"


def padded(rigs: tuple[Rig, ...], channels: int = 3, stride: int = 1) -> torch.Tensor:
    """Random images or maps of a stride; zeros in the padding."""
    batch = torch.zeros(len(rigs), 6, channels, -(-36 // stride), -(-64 // stride))
    for sample, rig in enumerate(rigs):
        part = crop(batch[sample : sample + 1], rig, stride)
        part.copy_(torch.rand(part.shape))
    return batch


@torch.no_grad()
@pytest.mark.parametrize("option", ["truth", "sweep", "mono", "omnimvs", PRETRAINED, "omnimvs3d"])
def test_depth(option, rigs, smoke):
    model = build(smoke(*f"model/depth={option}".split(), "preset.panorama.height=16").depth).eval()
    images, true_m = padded(rigs), torch.rand(2, 16, 48) * 20
    both = model(images, rigs, true_m)
    for sample, rig in enumerate(rigs):
        part = slice(sample, sample + 1)
        single = model(crop(images[part], rig), (rig,), true_m[part])
        for ours, expected in zip(both, single, strict=True):
            torch.testing.assert_close(ours[part], expected, atol=1e-4, rtol=1e-4)


@torch.no_grad()
@pytest.mark.parametrize("option", ["mono", "omnimvs", PRETRAINED, "omnimvs3d"])
@pytest.mark.parametrize("seed", [0, 1])  # with and without mirroring
def test_losses_of_depth(option, seed, rigs, smoke):
    model = build(smoke(*f"model/depth={option}".split(), "preset.panorama.height=16").depth)
    images, erp_m, camera_m = padded(rigs), torch.rand(2, 16, 48) * 20, 20 * padded(rigs, 1)[:, :, 0]
    both = model.weighted_losses(images, rigs, erp_m, camera_m, torch.Generator().manual_seed(seed))
    parts = []
    for sample, rig in enumerate(rigs):
        part = slice(sample, sample + 1)
        ranges = erp_m[part], crop(camera_m[part], rig)
        parts.append(
            model.weighted_losses(crop(images[part], rig), (rig,), *ranges, torch.Generator().manual_seed(seed))
        )
    for name, term in both.items():
        torch.testing.assert_close(term, (parts[0][name] + parts[1][name]) / 2, atol=1e-4, rtol=1e-4)


@torch.no_grad()
@pytest.mark.parametrize("name", ["Coloring", "CoarseColoring", "Pillar", "LiftSplat"])
def test_lifter(name, rigs):
    sizes = {"layers": 1, "heads": 2, "points": 2, "feedforward_channels": 8}
    lifter = {
        "Coloring": lambda: Coloring(GRID, 8, LEVELS, **sizes),
        "CoarseColoring": lambda: CoarseColoring(GRID, 8, LEVELS, block=2, **sizes),
        "Pillar": lambda: Pillar(GRID, 8, 8, LEVELS, heights=2, **sizes),
        "LiftSplat": lambda: LiftSplat(GRID, 8, 8, LEVELS, 4, (0.5, 20.5)),
    }[name]()
    features = [padded(rigs, 8, stride) for stride in LEVELS]
    candidates = (torch.rand(1, *GRID.shape) < 0.7).expand(2, -1, -1, -1)
    both = lifter(features, Sketched(candidates), rigs)
    for sample, rig in enumerate(rigs):
        part = [crop(maps[sample : sample + 1], rig, stride) for maps, stride in zip(features, LEVELS, strict=True)]
        single = lifter(part, Sketched(candidates[:1]), (rig,))
        torch.testing.assert_close(both[sample], single[0])
    assert not torch.allclose(both[0], both[1])


@torch.no_grad()
@pytest.mark.parametrize(
    "system", ["default", "bevdet", "bevformer", "voxformer", "default model/backbone=efficientnet_lite0"]
)
def test_the_whole_model_with_a_rig_that_changes_from_frame_to_frame(system, rigs, make_ring, smoke):
    model = build(smoke(*f"model={system}".split(), "preset.panorama.height=16").model).eval()
    frames = model.temporal.frames
    windows = tuple(
        tuple(make_ring(len(rig.cameras), *size, radius_m=0.9 + 0.1 * t) for t in range(frames))
        for rig, size in zip(rigs, ((64, 36), (48, 32)), strict=True)
    )
    images = torch.stack([padded(rigs) for _ in range(frames)], 1)
    poses = torch.eye(4, dtype=torch.float64).repeat(2, frames, 1, 1)
    poses[:, :, 0, 3] = torch.arange(frames)
    both = model(images, windows, poses)
    for sample, rig in enumerate(rigs):
        part = slice(sample, sample + 1)
        cropped = torch.stack([crop(images[part, t], rig) for t in range(frames)], 1)
        single = model(cropped, windows[part], poses[part])
        torch.testing.assert_close(both.logits[part], single.logits, atol=1e-4, rtol=1e-4)
        if single.pixel_logits is not None:
            inner = crop(both.pixel_logits[part], rig, 4)
            torch.testing.assert_close(inner, single.pixel_logits, atol=1e-4, rtol=1e-4)


@torch.no_grad()
def test_each_frame_is_lifted_through_its_own_rig(rigs, make_ring, smoke):
    model = build(smoke("model/sketch=dense", "model/temporal=mean").model).eval()
    frames = model.temporal.frames
    images, poses = torch.rand(1, frames, 6, 3, 36, 64), torch.eye(4, dtype=torch.float64).repeat(1, frames, 1, 1)
    still, moved = rigs[0], make_ring(6, radius_m=1.4)
    expected = model(images, ((still,) * frames,), poses).logits
    for frame in range(frames):
        window = tuple(moved if t == frame else still for t in range(frames))
        assert not torch.allclose(model(images, (window,), poses).logits, expected)
    with pytest.raises(ValueError, match=f"1 samples of {frames} frames"):
        model(images, ((still,),), poses)
