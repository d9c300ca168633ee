"""A dataset with other classes, another grid, other cameras and fewer labels trains without an edit elsewhere."""

import pytest
import torch
from fake_scene import FakeWorld
from fake_source import CLASSES, FakeSource
from fake_source import GRID as FAKE_GRID
from lightning.pytorch import Trainer, seed_everything
from omegaconf import OmegaConf

from omniocc.config import build, check_root
from omniocc.data import Recorded, SceneSource
from omniocc.data.source import SceneFrames, VoxelLabels
from omniocc.errors import UserError
from omniocc.geometry import Cylinder
from omniocc.parts import Parts
from omniocc.train.build import build_task
from omniocc.train.data_module import DataModule

pytestmark = [
    pytest.mark.filterwarnings("ignore::UserWarning:lightning.*"),
    pytest.mark.filterwarnings("ignore:`isinstance:FutureWarning"),
]
PATTERNS = {split: [f"{split}-*"] for split in ("train", "val", "test")}
GRID = [
    "model/geometry=cuboid",
    "model.geometry.shape=[20,16,4]",
    "model.geometry.x_m=[-40,40]",
    "model.geometry.y_m=[-32,32]",
    "model.geometry.height_m=[-1.0,5.4]",
]


@pytest.fixture
def compose(smoke, tmp_path):
    def make(*overrides, with_lidar=False):
        cfg = smoke("model/sketch=dense", *GRID, "packages=[fake_source]", "logger.mode=disabled", *overrides)
        OmegaConf.set_struct(cfg, False)
        cfg.data.source = {"_target_": "fake_source.FakeSource", "folder": str(tmp_path), "with_lidar": with_lidar}
        check_root(cfg)
        return cfg

    return make


def train(cfg):
    """Train and test; returns training logs and test figures."""
    seed_everything(0, verbose=False)
    data = build(cfg.data)
    data.prepare_data()
    data.setup()
    task = build_task(Parts(cfg), data.source.spec)
    task.set_training_statistics(data.voxel_counts())
    trainer = Trainer(
        accelerator="cpu",
        logger=False,
        enable_progress_bar=False,
        enable_model_summary=False,
        enable_checkpointing=False,
        num_sanity_val_steps=0,
        max_steps=3,
    )
    trainer.fit(task, datamodule=DataModule(data))
    logged = dict(trainer.logged_metrics)
    return logged, trainer.test(task, datamodule=DataModule(data), verbose=False)[0]


@pytest.fixture(params=["virtual", "recorded", "fake"])
def source(request, tmp_path):
    world = FakeWorld(tmp_path, scenes=(1, 1, 1), frames=2)
    world.prepare()
    options = {"virtual": world, "recorded": Recorded(str(world.place), PATTERNS), "fake": FakeSource(str(tmp_path))}
    return options[request.param]


def test_sources_keep_the_contracts(source):
    source.prepare()
    assert isinstance(source, SceneSource)
    scene = source.scenes("val")[0]
    assert isinstance(scene, SceneFrames)
    assert len(scene.rigs) == len(scene.world_from_ego) == len(scene)
    grid = FAKE_GRID if isinstance(source, FakeSource) else Cylinder((8, 10, 4))
    labels = source.labels(grid, "none")
    assert isinstance(labels, VoxelLabels)
    labels.prepare([scene])
    assert labels.read(scene, 0).shape == grid.shape
    assert labels.counts([scene]).shape == (source.spec.classes.num_classes, *grid.shape)


@pytest.mark.parametrize("with_lidar", [False, True])
def test_another_dataset_trains_and_is_tested(compose, with_lidar):
    logged, figures = train(compose("data.num_classes=19", "data.batch_size=4", with_lidar=with_lidar))
    assert {"train/loss/ce", "train/loss/scal", "train/loss/dice"} <= set(logged)
    assert "train/loss/semantics" not in logged
    assert all(torch.isfinite(value) for key, value in logged.items() if key.startswith("train/"))
    names = {row.name for row in CLASSES.rows[1:]}
    assert {key.removeprefix("test/rayiou/") for key in figures if key.startswith("test/rayiou/")} == names
    assert {"test/rayiou", "test/rayiou_0-20m", "test/rayiou_20-40m", "label/rayiou", "prior/voxel/iou"} <= set(figures)
    assert any("lidar" in key for key in figures) == with_lidar
    assert 0 <= figures["test/voxel/iou"] <= 1
    assert figures["label/voxel/iou"] == 1.0


def test_another_number_of_classes_is_one_clear_line(compose):
    data = build(compose().data)
    with pytest.raises(UserError, match=r"data\.num_classes=12.*19 classes.*kind18.*data\.num_classes=19"):
        data.prepare_data()
