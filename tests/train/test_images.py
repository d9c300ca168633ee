from types import SimpleNamespace

import cv2
import numpy as np
import pytest
import torch
from lightning.pytorch import LightningModule, Trainer
from lightning.pytorch.loggers import CSVLogger
from torch.utils.data import DataLoader

from omniocc.batch import Batch
from omniocc.camera import Equirectangular, Rig
from omniocc.classes import WORLD_CLASSES
from omniocc.draw import SheetParts
from omniocc.errors import UserError
from omniocc.geometry import Cylinder
from omniocc.runs.curves import read_curve
from omniocc.train.images import DepthImages, Drawn, FrameImages, OccupancyImages, SketchImages

GRID = Cylinder(shape=(6, 10, 4))
PANORAMA = Equirectangular(24, 6, 45.0, -45.0)
RIG = Rig.load("fisheye6").resized(64, 36)
FRAMES, BATCH = 7, 2


class FakeModel:
    geometry = GRID
    panorama = PANORAMA

    def logits(self, range_m, valid):
        assert bool((range_m[valid] > 0).all())
        return torch.zeros(1, 2, *GRID.shape)

    def undilated_candidates(self, logits):
        return logits[:, 0] > 1


def batch_of(names):
    count = len(names)
    depth_m = torch.rand(count, 6, 24) * 20 + 1
    depth_m[:, 0] = torch.nan
    return Batch(
        images=torch.randint(0, 256, (count, 1, 6, 3, 36, 64), dtype=torch.uint8),
        rigs=((RIG,),) * count,
        world_from_ego=torch.eye(4, dtype=torch.float64).expand(count, 1, 4, 4),
        voxels=torch.randint(0, 12, (count, *GRID.shape), dtype=torch.uint8),
        pixel_labels=torch.zeros(count, 6, 36, 64, dtype=torch.uint8),
        lidar_range_m=torch.zeros(count, 1),
        lidar_labels=torch.zeros(count, 1, dtype=torch.uint8),
        frame_ids=names,
        erp_range_m=torch.rand(count, 6, 24) * 20 + 1,
        depth_range_m=depth_m,
    )


OUTPUTS = {
    OccupancyImages: lambda batch: batch.voxels,
    DepthImages: lambda batch: batch.depth_range_m,
    SketchImages: lambda batch: batch.voxels > 6,
}


def run(callback, root=True):
    """Passes all frames through the callback, as a test and as a validation."""
    loader = SimpleNamespace(batch_size=BATCH, dataset=range(2 * FRAMES), sampler=range(FRAMES))  # of two processes
    trainer = SimpleNamespace(is_global_zero=root, loggers=[], global_step=31, test_dataloaders=loader)
    trainer.fit_loop = SimpleNamespace(epoch_loop=SimpleNamespace(_batches_that_stepped=30))
    task = SimpleNamespace(model=FakeModel(), sketch=FakeModel())
    for number, first in enumerate(range(0, FRAMES, BATCH)):
        batch = batch_of(tuple(f"scene/{k:04d}" for k in range(first, min(first + BATCH, FRAMES))))
        outputs = OUTPUTS[type(callback)](batch)
        callback.on_test_batch_end(trainer, task, outputs, batch, number)
        callback.on_validation_batch_end(trainer, task, outputs, batch, number)


@pytest.mark.parametrize("kind", list(OUTPUTS))
def test_frames_are_spread_over_the_test_set(kind, tmp_path):
    run(kind(tmp_path / "images", 3, WORLD_CLASSES))
    names = sorted(path.name for path in tmp_path.glob("images/*.png"))
    assert names == ["test-00-scene-0000.png", "test-01-scene-0003.png", "test-02-scene-0006.png", "val-step000030.png"]
    assert cv2.imread(str(tmp_path / "images" / names[1])).shape[1] == 1280


@pytest.mark.parametrize(("count", "root"), [(0, True), (3, False)])
def test_nothing_is_drawn_unasked_or_by_other_ranks(count, root, tmp_path):
    run(DepthImages(tmp_path / "images", count, WORLD_CLASSES), root)
    assert not list(tmp_path.iterdir())


def test_parts_of_test_sheets_are_files_of_their_own(tmp_path):
    run(OccupancyImages(tmp_path / "images", 3, WORLD_CLASSES))
    sheet = cv2.imread(str(tmp_path / "images" / "test-01-scene-0003.png"))
    folder = tmp_path / "images" / "parts" / "test-01-scene-0003"
    parts = {path.stem: cv2.imread(str(path)) for path in folder.iterdir()}
    assert sorted(parts) == sorted(SheetParts._fields)
    assert sorted(path.name for path in folder.parent.iterdir()) == [
        "test-00-scene-0000",
        "test-01-scene-0003",
        "test-02-scene-0006",
    ]
    for name, part in parts.items():
        found = cv2.matchTemplate(sheet, part, cv2.TM_SQDIFF).min()
        assert found <= 1e-6 * part.size * 255**2, name
    run(DepthImages(tmp_path / "depth", 3, WORLD_CLASSES))
    assert not (tmp_path / "depth" / "parts").exists()


def test_a_negative_number_of_images_is_refused(tmp_path):
    with pytest.raises(UserError, match="-1 test images: give 0"):
        OccupancyImages(tmp_path, -1, WORLD_CLASSES)


class Steps(LightningModule):
    """A linear layer that logs a score in every validation."""

    def __init__(self):
        super().__init__()
        self.layer = torch.nn.Linear(1, 1)

    def training_step(self, batch, index):
        return self.layer(batch.images).mean()

    def validation_step(self, batch, index):
        self.log("val/rayiou", 0.5, batch_size=1)
        return batch.images[None]

    def configure_optimizers(self):
        return torch.optim.SGD(self.parameters(), 0.1)


class OnePixel(FrameImages):
    key = "voxels"

    def draw(self, task, output, batch, sample):
        return Drawn(np.zeros((1, 1, 3), np.uint8))


def test_images_of_validations_have_the_steps_of_the_curves(tmp_path):
    """Also where batches are accumulated, and of the validation after the training."""
    frames = [SimpleNamespace(images=torch.ones(1, 1), frame_ids=("a/0",)) for _ in range(12)]
    loader = DataLoader(frames, batch_size=None)
    trainer = Trainer(
        max_steps=6,
        val_check_interval=4,
        check_val_every_n_epoch=None,
        accumulate_grad_batches=2,
        accelerator="cpu",
        limit_val_batches=1,
        num_sanity_val_steps=0,
        enable_checkpointing=False,
        enable_progress_bar=False,
        enable_model_summary=False,
        logger=CSVLogger(tmp_path, name="csv", flush_logs_every_n_steps=1),
        callbacks=[OnePixel(tmp_path / "images", 1, WORLD_CLASSES)],
    )
    task = Steps()
    trainer.fit(task, loader, loader)
    trainer.validate(task, loader, verbose=False)
    steps = sorted(read_curve(tmp_path, "val/rayiou"))
    assert [path.name for path in sorted(tmp_path.glob("images/*"))] == [f"val-step{step:06d}.png" for step in steps]
    assert len(steps) == 4
