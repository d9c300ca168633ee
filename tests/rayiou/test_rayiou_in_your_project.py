"""The page 'RayIoU in your own project in ten lines', run on small stand-ins of a dataset and a model."""

import re
from pathlib import Path

import numpy as np
import pytest
import torch

from omniocc.geometry import Cuboid
from omniocc.metric import RayIoU

PAGE = Path(__file__).parents[2] / "docs" / "how_to" / "rayiou_in_your_project.md"
SHAPE = (200, 200, 16)
FILES, LOOP, ALONE, LIGHTNING = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), flags=re.DOTALL)


def street(shift=0):
    labels = np.full(SHAPE, 17, np.uint8)
    labels[:, :, 1], labels[140 + shift, :, :12] = 11, 15  # a road, and a house 16 m ahead
    return labels


@pytest.fixture
def scene(tmp_path, monkeypatch):
    """Two frames of a scene, 5 m apart, whose predictions are found one cell too far."""
    folder = tmp_path / "scene-0001"
    for name, key, shift in (("predictions", "pred", 1), ("gts", "semantics", 0)):
        (folder / name).mkdir(parents=True)
        for frame in range(2):
            np.savez_compressed(folder / name / f"{frame}.npz", **{key: street(shift)})
    poses = np.tile(np.eye(4), (2, 1, 1))
    poses[1, 0, 3] = 5.0
    mounted = np.tile(np.eye(4), (2, 1, 1))
    mounted[:, :3, 3] = 0.99, 0.0, 1.84
    np.savez(folder / "poses.npz", world_from_ego=poses, ego_from_lidar=mounted)
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def names(scene):
    """The names that the first example defines."""
    found = {}
    exec(compile(FILES, str(PAGE), "exec"), found)
    return found


def test_files_of_predictions(names, capsys):
    scores = names["scores"]
    assert scores["rayiou/11"] == pytest.approx(1.0, abs=0.02)
    assert 0.8 < scores["rayiou/15"] <= 1
    assert names["metric"].seen.origins == 2
    assert {"rayiou_past", "rayiou_now", "rayiou_future"} <= set(scores)
    twice = RayIoU(names["grid"], 18, 17)
    starts = torch.tensor([[[0.99, 0.0, 1.84], [5.99, 0.0, 1.84]], [[-4.01, 0.0, 1.84], [0.99, 0.0, 1.84]]])
    twice.update(torch.from_numpy(np.stack([street(1)] * 2)), torch.from_numpy(np.stack([street()] * 2)), starts)
    assert scores["rayiou"] == float(twice.compute()["rayiou"])
    body = [line for line in FILES.splitlines() if line and not line.startswith(("import", "from"))]
    assert len(body) <= 10, "more than ten lines"


def test_loop_of_mmdet3d(names):
    exec(compile(LOOP, str(PAGE), "exec"), names)
    truth = torch.from_numpy(np.stack([street()] * 2))
    origins, times = torch.tensor([[[0.99, 0.0, 1.84]]] * 2), torch.zeros(2, 1)
    batch = {"img": torch.zeros(2), "voxel_semantics": truth, "ray_origins": origins, "ray_times": times}

    def model(return_loss, rescale, **data):
        assert (return_loss, rescale) == (False, True)
        return list(data["voxel_semantics"].numpy())

    metric = RayIoU(names["grid"], 18, 17, split_origins=True)
    found = names["evaluate"](model, [batch, batch], metric)
    assert found["rayiou_now"] == found["rayiou"] == 1
    exec(compile(ALONE, str(PAGE), "exec"), names)
    assert float(names["scores"]["rayiou/15"]) == pytest.approx(1.0, abs=0.2)


@pytest.mark.filterwarnings("ignore::UserWarning:lightning.*")
@pytest.mark.filterwarnings("ignore:`isinstance:FutureWarning")
def test_lightning(names):
    from lightning.pytorch import Trainer
    from torch.utils.data import DataLoader

    exec(compile(LIGHTNING, str(PAGE), "exec"), names)
    names["grid"] = Cuboid((20, 20, 16), x_m=(-4, 4), y_m=(-4, 4), height_m=(-3, 3.4))
    labels = torch.full((2, 20, 20, 16), 17, dtype=torch.uint8)
    labels[:, :, :, 1] = 11
    batch = {"images": torch.nn.functional.one_hot(labels.long(), 18).movedim(-1, 1), "labels": labels}
    batch["mask_camera"] = torch.ones_like(labels, dtype=torch.bool)
    task = names["Occupancy"](torch.nn.Identity())
    trainer = Trainer(accelerator="cpu", logger=False, enable_progress_bar=False, enable_checkpointing=False)
    (logged,) = trainer.validate(task, DataLoader([batch, batch], batch_size=None), verbose=False)
    assert logged["val/rayiou"] == logged["val/miou"] == logged["val/rayiou/11"] == 1
    assert task.metrics["rays"].truth.sum() == 0
