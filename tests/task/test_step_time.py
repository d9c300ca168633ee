import pytest
import torch

from omniocc.camera import Rig
from omniocc.config import build
from omniocc.errors import UserError
from omniocc.task.step_time import planned_scenes, random_batch, rehearse, step_seconds


@pytest.mark.parametrize("stage", ["depth", "sketch", "occupancy"])
def test_a_step_of_every_stage_takes_time_and_needs_no_data(stage, smoke, spec):
    cfg = smoke("model=extended")
    rig = Rig.load("fisheye6").resized(64, 36)
    assert 0 < step_seconds(cfg, stage, rig, spec, torch.device("cpu"), steps=1) < 60


def test_a_part_that_does_not_fit_is_told_by_one_step(smoke, spec, monkeypatch):
    monkeypatch.setattr("omniocc.model.refiner.UNet.forward", lambda self, volume, sketched: volume[..., 1:])
    rig = Rig.load("fisheye6").resized(64, 36)
    with pytest.raises(UserError, match=r"model\.refiner\.\S+ returned features of shape"):
        rehearse(smoke(), ("depth", "sketch", "occupancy"), rig, spec, torch.device("cpu"))


def test_noise_has_the_shapes_of_the_configuration(smoke):
    cfg = smoke()
    batch = random_batch(cfg, Rig.load("fisheye6").resized(64, 36), 3, 2)
    assert batch.images.shape == (3, 2, 6, 3, 36, 64)
    assert batch.voxels is not None
    assert batch.voxels.shape == (3, *build(cfg.model.geometry).shape)
    assert 0.05 < (batch.voxels > 0).float().mean() < 0.15
    assert int(batch.voxels.max()) < cfg.data.num_classes


def test_scenes_of_the_virtual_world_are_planned_before_they_are_rendered(smoke, tmp_path):
    cfg = smoke(f"paths.data={tmp_path}", "data.source.train_scenes=7", "data.source.frames_per_scene=4")
    rig, frames = planned_scenes(build(cfg.data).source)
    assert (len(rig.cameras), frames) == (6, 28)
    assert not list(tmp_path.iterdir())
