import pytest

from omniocc.config import build
from omniocc.data.source.cameras import training_frames, training_rig
from omniocc.errors import UserError
from omniocc.parts import Parts
from omniocc.train.command import random_batch, rehearse, step_seconds
from omniocc.train.stages import stages_of


@pytest.fixture
def stages(smoke, tmp_path):
    def make(*overrides):
        parts = Parts(smoke(f"paths.data={tmp_path}", *overrides))
        return stages_of(parts, parts.data())

    return make


def test_a_step_of_every_stage_takes_time_and_needs_no_data(stages, tmp_path):
    found = stages("model=extended")
    assert [stage.NAME for stage in found] == ["depth", "sketch", "occupancy"]
    assert all(0 < step_seconds(stage, steps=1) < 60 for stage in found)
    assert not list(tmp_path.iterdir())


def test_a_part_that_does_not_fit_is_told_by_one_step(stages, monkeypatch):
    monkeypatch.setattr("omniocc.model.refiner.UNet.forward", lambda self, volume, sketched: volume[..., 1:])
    with pytest.raises(UserError, match=r"model\.refiner\.\S+ returned features of shape"):
        rehearse(stages())


def test_noise_has_the_shapes_of_the_configuration(stages):
    last = stages("stages.occupancy.batch_size=3", "model.temporal.frames=2")[-1]
    batch = random_batch(last, training_rig(last.data.source))
    assert batch.images.shape == (3, 2, 6, 3, 36, 64)
    assert batch.voxels is not None
    assert batch.voxels.shape == (3, *last.data.geometry.shape)
    assert 0.05 < (batch.voxels > 0).float().mean() < 0.15
    assert int(batch.voxels.max()) < last.data.num_classes


def test_scenes_of_the_virtual_world_are_planned_before_they_are_rendered(smoke, tmp_path):
    cfg = smoke(f"paths.data={tmp_path}", "data.source.train_scenes=7", "data.source.frames_per_scene=4")
    source = build(cfg.data).source
    assert (len(training_rig(source).cameras), training_frames(source)) == (6, 28)
    assert not list(tmp_path.iterdir())
