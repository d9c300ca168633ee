"""What a training refuses before anything is rendered, made or trained."""

import pytest

from omniocc.config import ConfigError
from omniocc.errors import UserError
from omniocc.parts import Parts
from omniocc.train.build import least_bytes
from omniocc.train.command import train
from omniocc.train.stage_keys import STAGES


@pytest.mark.parametrize(
    ("override", "message"),
    [
        (
            "data.batch_size=4",
            "data.batch_size=4: there are 3 training frames, less than the 4 of a step on 1 device",
        ),
        (
            "stages.depth.batch_size=1 trainer.accumulate_grad_batches=4",
            "stages.depth.batch_size=1 trainer.accumulate_grad_batches=4: there are 3 training frames, less than the 4",
        ),
        ("stages.depth.batch_size=1000000", "stages.depth.batch_size=1000000: there are 3 training frames"),
        ("data.source.train_scenes=0", "stages.depth.batch_size=2: there are 0 training frames"),
        (
            "data.batch_size=1000000000",
            "data.batch_size=1000000000 model.geometry.shape=[16, 20, 4] model.lifter.channel",
        ),
        (
            "model.geometry.shape=[1000000,1000,1000]",
            "stages.sketch.batch_size=2 model.geometry.shape=[1000000, 10",
        ),
        ("depth.panorama.width=65536 depth.panorama.height=65536 stages.depth.batch_size=1000", "GiB of memory"),
        ("+trainer.val_check_interval=2", "trainer.val_check_interval=2 has no effect: steps end the training"),
        ("data.seed=5", "data.seed=5 has no effect: the order of samples follows from stages.<stage>.seed"),
        ("stage=depth weights=tiny", "weights=tiny is for the occupancy stage, which stage=depth leaves out; stages"),
        ("stage=sketch resume=a.ckpt", "resume=a.ckpt is for the occupancy stage, which stage=sketch leaves out"),
        ("trainer.devices=3 trainer.accelerator=cpu", "the split 'val' has 1 frame for 3 devices"),
        ("trainer.devices=-1 trainer.accelerator=cpu", "trainer.accelerator=cpu trainer.devices=-1"),
        ("trainer.devices=0 trainer.accelerator=cpu", "trainer.accelerator=cpu trainer.devices=0"),
    ],
)
def test_what_cannot_be_trained_is_a_line_before_anything_is_rendered(override, message, smoke, tmp_path):
    places = [f"paths.data={tmp_path}/data", f"paths.runs={tmp_path}/runs", "logger.mode=disabled"]
    cfg = smoke(*places, "data.source.frames_per_scene=1", *override.split())
    with pytest.raises(UserError) as caught:
        train(cfg)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)
    assert list(tmp_path.iterdir()) == []


def test_edges_of_panoramas_are_checked_where_they_are_rendered(smoke):
    with pytest.raises(ConfigError, match=r"data.source: top_deg 120.0 and bottom_deg"):
        Parts(smoke("data.source.erp_top_deg=120")).source()


def test_the_least_that_a_step_takes(smoke):
    overrides = ["data.batch_size=3", "stages.sketch.batch_size=5", "stages.depth.batch_size=7"]
    needed = dict(least_bytes(Parts(smoke(*overrides)).config, STAGES))
    assert list(needed.values()) == [4 * 7 * 48 * 12, 4 * 5 * 16 * 20 * 4, 2 * 3 * 16 * 20 * 4 * 8]
    assert [keys.split()[0] for keys in needed] == [
        *("stages.depth.batch_size=7", "stages.sketch.batch_size=5", "data.batch_size=3")
    ]


def test_a_foreign_part_without_the_keys_has_no_least():
    config = {
        "data": {"geometry": {"_target_": "other.Grid"}},
        "stages": {stage: {"batch_size": 1} for stage in STAGES},
        "depth": {},
        "model": {"lifter": {}},
    }
    assert [size for _, size in least_bytes(config, STAGES)] == [4, 4, 2]
