"""Every system trains and is tested on public datasets, in small copies of their layout."""

import pytest
import torch
from lightning.pytorch import Trainer, seed_everything
from nuscenes_files import write_nuscenes

from omniocc.config import build, check_root
from omniocc.errors import UserError
from omniocc.task.build import build_task
from omniocc.task.submission import score_files, write_files

pytestmark = [
    pytest.mark.slow,
    pytest.mark.filterwarnings("ignore::UserWarning:lightning.*"),
    pytest.mark.filterwarnings("ignore:`isinstance:FutureWarning"),
]
CUBOID = ["model/geometry=cuboid", "model.geometry.shape=[20,20,4]", "model.geometry.x_m=[-40.8,39.2]",
          "model.geometry.y_m=[-40,40]"]  # fmt: skip


@pytest.fixture(scope="module")
def occ3d(tmp_path_factory):
    root = write_nuscenes(tmp_path_factory.mktemp("nuscenes"), frames=2)
    return ["data=occ3d_nuscenes", f"data.source.root={root}", "data.source.val_every=2"]


def train(cfg):
    """Train two steps and test; returns training logs, test figures, task and data."""
    check_root(cfg)
    seed_everything(0, verbose=False)
    data = build(cfg.data)
    data.prepare_data()
    data.setup()
    task = build_task(cfg, data.source.spec)
    task.set_training_statistics(data.voxel_counts())
    trainer = Trainer(
        accelerator="cpu", logger=False, enable_progress_bar=False, enable_model_summary=False,
        enable_checkpointing=False, num_sanity_val_steps=0, max_steps=2,
    )  # fmt: skip
    trainer.fit(task, datamodule=data)
    logged = dict(trainer.logged_metrics)
    return logged, trainer.test(task, datamodule=data, verbose=False)[0], task, data


@pytest.mark.parametrize(
    "system",
    [
        ["model=bevformer", *CUBOID],
        ["model=bevdet", *CUBOID],
        ["model=voxformer", *CUBOID],
        ["model=extended"],
        ["model/sketch=mono"],
        ["model/sketch=random"],
        ["model/sketch=dense", "data.unknown=unseen"],
    ],
    ids=" ".join,
)
def test_every_system_runs_on_occ3d(smoke, occ3d, system):
    logged, figures, *_ = train(smoke(*system, *occ3d, "logger.mode=disabled"))
    assert all(torch.isfinite(value) for key, value in logged.items() if key.startswith("train/"))
    assert 0 <= figures["test/rayiou"] <= 1
    assert figures["label/rayiou"] > 0
    assert {"test/rayiou/driveable_surface", "test/rayiou_0-20m", "test/voxel/miou", "prior/voxel/iou"} <= set(figures)


def test_predictions_written_as_files_get_the_scores_of_the_test(smoke, occ3d, tmp_path):
    _, figures, task, data = train(smoke("model/sketch=dense", *occ3d, "logger.mode=disabled"))
    device = torch.device("cpu")
    assert write_files(task, data, tmp_path, "test", device) == 2
    assert sorted(path.name for path in tmp_path.iterdir()) == ["scene-0003-0.npz", "scene-0003-1.npz"]
    scores = score_files(data.source, tmp_path)
    assert scores["test/rayiou"] > 0
    for key, value in scores.items():
        assert value == pytest.approx(figures[key], abs=1e-6, nan_ok=True)
    (tmp_path / "scene-0003-0.npz").write_bytes(b"kept")
    write_files(task, data, tmp_path, "test", device)  # what is there is not predicted again
    assert (tmp_path / "scene-0003-0.npz").read_bytes() == b"kept"
    with pytest.raises(UserError, match="split=all: choose train, val, test"):
        write_files(task, data, tmp_path, "all", device)
