"""The systems the paper compares with, composed as `train.py` composes them, at the smallest sizes."""

import pytest
import torch

from omniocc.camera import Rig
from omniocc.config import build, check_root
from omniocc.model.protocols import part_of
from omniocc.model.sketch import Random, Sketched

PARTS = {
    "bevdet": ("Dense", "LiftSplat", "NoTemporal", "Conv"),
    "bevformer": ("Dense", "Pillar", "Recurrent", "Conv"),
    "voxformer": ("Omni", "CoarseColoring", "NoTemporal", "Attention"),
    "flashocc": ("Dense", "LiftSplat", "NoTemporal", "ChannelToHeight"),
    "fosocc": ("Dense", "SplatColoring", "NoTemporal", "Focus"),
    "oneocc": ("Dense", "BiGrid", "NoTemporal", "Experts"),
    "adaptiveocc": ("Dense", "CoarseToFine", "NoTemporal", "Conv"),
}
SYSTEMS = pytest.mark.parametrize("name", list(PARTS))
ON_BOTH_GRIDS = pytest.mark.parametrize("grid", ["cuboid", "cylinder"])


@pytest.fixture
def make(smoke, as_trained):
    return lambda name, grid="cuboid": as_trained(build(smoke(f"model={name}", f"model/geometry={grid}").model))


def window(model, batch=2):
    """Images, poses and a quarter of the voxels as candidates."""
    frames = model.temporal.frames
    images = torch.rand(batch, frames, 6, 3, 36, 64)
    poses = torch.eye(4, dtype=torch.float64).repeat(batch, frames, 1, 1)
    poses[:, :, 0, 3] = torch.arange(frames)
    candidates = Random(model.geometry, 0.1)(images[:, 0], (Rig.load("fisheye6"),) * batch).candidates
    return images, poses, Sketched(candidates[:, None].expand(-1, frames, -1, -1, -1))


@SYSTEMS
def test_each_is_a_composition_of_slots_on_the_same_backbone(name, smoke):
    ours, cfg = smoke(), smoke(f"model={name}")
    check_root(cfg)
    assert cfg.model.backbone == ours.model.backbone
    parts = tuple(cfg.model[slot]._target_.rsplit(".", 1)[-1] for slot in ("sketch", "lifter", "temporal", "refiner"))
    assert parts == PARTS[name]
    assert cfg.model.geometry._target_.endswith("Cuboid")
    assert cfg.model.semantic_head._target_.endswith("FCN" if name == "adaptiveocc" else "NoSemanticHead")


def test_voxformer_uses_monocular_depth(smoke):
    assert smoke("model=voxformer").depth._target_ == "omniocc.model.depth.Mono"


@SYSTEMS
@pytest.mark.parametrize("preset", ["small", "paper"])
def test_every_preset_has_sizes_that_fit(name, preset, composed):
    cfg = composed(f"preset={preset}", f"model={name}", "model.backbone.weights=null")
    check_root(cfg)
    for slot in ("lifter", "temporal", "refiner"):
        build(cfg.model[slot])


@SYSTEMS
@ON_BOTH_GRIDS
def test_batch_of_fisheye_and_pinhole_rig_equals_two_batches_of_one(name, grid, fisheye, pinhole, make):
    model = make(name, grid).double().eval()
    images, poses, candidates = window(model)
    with torch.no_grad():
        frames = images.shape[1]
        both = model(images.double(), ((fisheye,) * frames, (pinhole,) * frames), poses, candidates).logits
        assert both.shape == (2, 12, *model.geometry.shape)
        for index, rig in enumerate((fisheye, pinhole)):
            part = slice(index, index + 1)
            single = model(images[part].double(), ((rig,) * frames,), poses[part], part_of(candidates, part)).logits
            torch.testing.assert_close(both[part], single)


@SYSTEMS
@ON_BOTH_GRIDS
def test_gradients_reach_every_parameter_that_learns(name, grid, fisheye, make):
    model = make(name, grid)
    images, poses, candidates = window(model)
    found = model(images, ((fisheye,) * images.shape[1],) * 2, poses, candidates)
    outputs = [
        found.logits,
        *([] if found.pixel_logits is None else [found.pixel_logits]),
        *(logits for _, logits in found.coarse_logits),
    ]
    sum(output.square().mean() for output in outputs).backward()
    for parameter_name, parameter in model.named_parameters():
        if not parameter_name.startswith("sketch."):
            assert parameter.grad is not None, parameter_name
            assert torch.isfinite(parameter.grad).all(), parameter_name
            # the vector for voxels without a query is not used where every voxel has one
            assert parameter.grad.abs().sum() > 0 or parameter_name.endswith(".empty"), parameter_name
