"""Sheets of test frames: camera images, and the truth beside the prediction."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, ClassVar, NamedTuple

import numpy as np
import torch
from lightning.pytorch import Callback, LightningModule, Trainer
from torch import Tensor

from omniocc.batch import Batch
from omniocc.classes import UNKNOWN, ClassTable
from omniocc.data.spacing import evenly_spaced
from omniocc.draw import comparison_parts, comparison_sheet, depth_sheet, save_png, sketch_sheet
from omniocc.errors import UserError
from omniocc.runs.folder import PARTS
from omniocc.runs.wandb.loggers import wandb_of
from omniocc.runs.wandb.media import MediaItem, range_media, voxel_media
from omniocc.train.sketch import panorama


class Drawn(NamedTuple):
    """A sheet of a frame, and by name the parts that are also saved as files of their own."""

    sheet: np.ndarray
    parts: Mapping[str, np.ndarray] = MappingProxyType({})


class FrameImages(Callback, ABC):
    """Draw `count` frames spread evenly over the test set, and the first validation frame after each validation.

    Of several processes the first draws, which sees its part of the frames.
    Sheets go to `folder` (`test-00-<scene>-<frame>.png`, and `val-step000999.png` with the step of the curves), parts
    of test frames' sheets, which the report shows, to its `parts/test-00-<scene>-<frame>/<part>.png`. W&B gets the
    sheets (`val/<key>`, `test/<key>`) and for test frames also `media` (`test/<key of the medium>`).

    Args:
        count: number of test frames; 0 draws nothing.

    Raises:
        UserError: if the number is negative.
    """

    key: ClassVar[str]

    def __init__(self, folder: Path, count: int, classes: ClassTable):
        if count < 0:
            raise UserError(f"{count} test images: give 0 (none) or more")
        self.folder = folder
        self.count = count
        self.classes = classes
        self.shown: dict[str, list[MediaItem]] = {}

    @abstractmethod
    def draw(self, task: Any, output: Tensor, batch: Batch, sample: int) -> Drawn:
        """Return the sheet of one sample of a batch; `output` is what the task returned for it."""

    def media(self, task: Any, output: Tensor, batch: Batch, sample: int) -> dict[str, list[MediaItem]]:
        """Return further media for W&B, by key."""
        return {}

    def on_validation_batch_end(  # noqa: D102
        self, trainer: Trainer, pl_module: LightningModule, outputs: Any, batch: Batch, batch_idx: int, *_: Any
    ) -> None:
        if batch_idx == 0 and self.count and trainer.is_global_zero:
            sheet = self.draw(pl_module, outputs[0].cpu(), batch, 0).sheet
            step = logged_step(trainer)
            self._save(f"val-step{step:06d}", sheet)
            for curves in wandb_of(trainer.loggers):
                curves.log_media({f"val/{self.key}": [MediaItem(sheet, batch.frame_ids[0])]}, step)

    def on_test_batch_end(  # noqa: D102
        self, trainer: Trainer, pl_module: LightningModule, outputs: Any, batch: Batch, batch_idx: int, *_: Any
    ) -> None:
        if not trainer.is_global_zero or not self.count:
            return
        size = trainer.test_dataloaders.batch_size  # type: ignore[union-attr]
        total = len(trainer.test_dataloaders.sampler)  # type: ignore[union-attr, arg-type]
        drawn_indices = evenly_spaced(total, self.count)
        for sample, frame_id in enumerate(batch.frame_ids):
            index = batch_idx * size + sample
            if index in drawn_indices:
                output = outputs[sample].cpu()
                drawn = self.draw(pl_module, output, batch, sample)
                name = f"test-{drawn_indices.index(index):02d}-{frame_id.replace('/', '-')}"
                self._save(name, drawn.sheet)
                for part, image in drawn.parts.items():
                    self._save(f"{PARTS}/{name}/{part}", image)
                if wandb_of(trainer.loggers):
                    media = {self.key: [MediaItem(drawn.sheet, "")]} | self.media(pl_module, output, batch, sample)
                    self._show(media, frame_id)

    def on_test_epoch_end(self, trainer: Trainer, pl_module: LightningModule) -> None:  # noqa: D102
        for curves in wandb_of(trainer.loggers):
            curves.log_media(self.shown, trainer.global_step)
        self.shown = {}

    def _show(self, media: dict[str, list[MediaItem]], frame_id: str) -> None:
        for key, items in media.items():
            named = [MediaItem(item.content, " ".join([frame_id, item.caption]).strip()) for item in items]
            self.shown.setdefault(f"test/{key}", []).extend(named)

    def _save(self, name: str, image: np.ndarray) -> None:
        save_png(self.folder / f"{name}.png", image)


class OccupancyImages(FrameImages):
    """Draw true beside predicted voxels of the occupancy stage."""

    key = "voxels"

    def draw(self, task: Any, output: Tensor, batch: Batch, sample: int) -> Drawn:  # noqa: D102
        images, truth = newest_images(batch, sample), true_voxels(batch, sample, output)
        parts = comparison_parts(images, truth, output, task.model.geometry, self.classes)
        return Drawn(comparison_sheet(parts, self.classes, batch.frame_ids[sample]), parts._asdict())

    def media(self, task: Any, output: Tensor, batch: Batch, sample: int) -> dict[str, list[MediaItem]]:  # noqa: D102
        images, truth = newest_images(batch, sample), true_voxels(batch, sample, output)
        return voxel_media(images, batch.newest_rigs[sample], truth, output, task.model.geometry, self.classes)


class DepthImages(FrameImages):
    """Draw ranges of the depth stage: on the cameras' images, and as panoramas beside the true ones."""

    key = "depth"

    def draw(self, task: Any, output: Tensor, batch: Batch, sample: int) -> Drawn:  # noqa: D102
        images, truth = list(newest_images(batch, sample)), true_range_m(batch, sample, output)
        rig, frame_id = batch.newest_rigs[sample], batch.frame_ids[sample]
        return Drawn(depth_sheet(images, rig, task.model.panorama, output, truth, frame_id))

    def media(self, task: Any, output: Tensor, batch: Batch, sample: int) -> dict[str, list[MediaItem]]:  # noqa: D102
        return range_media(output, true_range_m(batch, sample, output), task.model.panorama)


class SketchImages(FrameImages):
    """Draw candidates of the sketch stage over true voxels, before and after dilation."""

    key = "sketch"

    def draw(self, task: Any, output: Tensor, batch: Batch, sample: int) -> Drawn:  # noqa: D102
        range_m, valid = (part[sample : sample + 1] for part in panorama(batch))
        with torch.inference_mode():
            raw = task.sketch.undilated_candidates(task.sketch.logits(range_m, valid))[0].cpu()
        sheet = sketch_sheet(
            list(newest_images(batch, sample)),
            true_voxels(batch, sample, output),
            raw,
            output,
            task.sketch.geometry,
            self.classes,
            panorama=task.sketch.panorama,
            range_m=range_m[0].masked_fill(~valid[0], torch.nan).cpu(),
            caption=batch.frame_ids[sample],
        )
        return Drawn(sheet)


def logged_step(trainer: Trainer) -> int:
    """Return the step under which the curves have the scores of a validation in progress, so that its image has it too.

    Lightning counts from 0: after 1,000 steps of training it is 999. It is 1,000 once training has ended.
    """
    return trainer.fit_loop.epoch_loop._batches_that_stepped


def newest_images(batch: Batch, sample: int) -> np.ndarray:
    """Return the images of the newest frame of a sample's window, (N, H, W, 3) uint8 RGB."""
    return batch.images[sample, -1].permute(0, 2, 3, 1).cpu().numpy()


def true_voxels(batch: Batch, sample: int, like: Tensor) -> Tensor:
    """Return the true voxels of a sample, in the shape of `like`; unknown everywhere if the data has none."""
    if batch.voxels is None:
        return torch.full(like.shape, UNKNOWN, dtype=torch.uint8)
    return batch.voxels[sample].cpu()


def true_range_m(batch: Batch, sample: int, like: Tensor) -> Tensor:
    """Return the true panorama of a sample, m, in the shape of `like`; nan everywhere if the data has none."""
    return torch.full_like(like, torch.nan) if batch.erp_range_m is None else batch.erp_range_m[sample].cpu()
