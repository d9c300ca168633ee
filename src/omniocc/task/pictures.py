"""Pictures of test frames: what the cameras saw, and true beside predicted."""

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
from omniocc.classes import WORLD_CLASSES
from omniocc.data.labels.class_fractions import spread
from omniocc.run.folder import PARTS
from omniocc.run.wandb.loggers import wandb_of
from omniocc.run.wandb.media import Named, range_media, voxel_media
from omniocc.task.sketch import panorama
from omniocc.view import comparison_parts, comparison_sheet, depth_sheet, save_png, sketch_sheet


class Drawn(NamedTuple):
    """A sheet of a frame, and by name those of its parts that are also saved alone."""

    sheet: np.ndarray
    parts: Mapping[str, np.ndarray] = MappingProxyType({})


class FramePictures(Callback, ABC):
    """Draws `count` frames spread evenly over the test set, and the first validation frame after each validation.

    Files go to `folder` (`test-00-<scene>-<frame>.png`), the parts of a test frame's sheet that the report shows beside
    it (`parts/test-00-<scene>-<frame>/<part>.png`). Where W&B is in use it gets them too (`val/<key>`,
    `test/<key>`), and of the test frames also `media` (`test/<its key>`).
    """

    key: ClassVar[str]

    def __init__(self, folder: Path, count: int):
        self.folder = folder
        self.count = count
        self.shown: dict[str, list[Named]] = {}

    @abstractmethod
    def picture(self, task: Any, output: Tensor, batch: Batch, sample: int) -> Drawn:
        """Draw the sheet of one sample of a batch, `output` being what the task's step returned for it."""

    def media(self, task: Any, output: Tensor, batch: Batch, sample: int) -> dict[str, list[Named]]:
        """What W&B shows besides, by key."""
        return {}

    def on_validation_batch_end(  # noqa: D102
        self,
        trainer: Trainer,
        pl_module: LightningModule,
        outputs: Any,
        batch: Batch,
        batch_idx: int,
        dataloader_idx: int = 0,
    ) -> None:
        if batch_idx == 0 and self.count and trainer.is_global_zero:
            picture = self.picture(pl_module, outputs[0].cpu(), batch, 0).sheet
            self._save(f"val-step{trainer.global_step:06d}", picture)
            for curves in wandb_of(trainer.loggers):
                curves.log_media({f"val/{self.key}": [Named(picture, batch.frame_ids[0])]}, trainer.global_step)

    def on_test_batch_end(  # noqa: D102
        self,
        trainer: Trainer,
        pl_module: LightningModule,
        outputs: Any,
        batch: Batch,
        batch_idx: int,
        dataloader_idx: int = 0,
    ) -> None:
        if not trainer.is_global_zero or not self.count:
            return
        size = trainer.test_dataloaders.batch_size  # type: ignore[union-attr]
        total = len(trainer.test_dataloaders.dataset)  # type: ignore[union-attr, arg-type]
        chosen = spread(total, self.count)
        for sample, frame_id in enumerate(batch.frame_ids):
            index = batch_idx * size + sample
            if index in chosen:
                output = outputs[sample].cpu()
                drawn = self.picture(pl_module, output, batch, sample)
                name = f"test-{chosen.index(index):02d}-{frame_id.replace('/', '-')}"
                self._save(name, drawn.sheet)
                for part, picture in drawn.parts.items():
                    self._save(f"{PARTS}/{name}/{part}", picture)
                if wandb_of(trainer.loggers):
                    media = {self.key: [Named(drawn.sheet, "")]} | self.media(pl_module, output, batch, sample)
                    self._show(media, frame_id)

    def on_test_epoch_end(self, trainer: Trainer, pl_module: LightningModule) -> None:  # noqa: D102
        for curves in wandb_of(trainer.loggers):
            curves.log_media(self.shown, trainer.global_step)
        self.shown = {}

    def _show(self, media: dict[str, list[Named]], frame_id: str) -> None:
        for key, items in media.items():
            named = [Named(item.content, " ".join([frame_id, item.caption]).strip()) for item in items]
            self.shown.setdefault(f"test/{key}", []).extend(named)

    def _save(self, name: str, picture: np.ndarray) -> None:
        path = self.folder / f"{name}.png"
        path.parent.mkdir(parents=True, exist_ok=True)
        save_png(path, picture)


class Pictures(FramePictures):
    """True beside predicted voxels, of the occupancy stage."""

    key = "voxels"

    def picture(self, task: Any, output: Tensor, batch: Batch, sample: int) -> Drawn:  # noqa: D102
        images, truth = newest_images(batch, sample), batch.voxels[sample].cpu()
        parts = comparison_parts(images, truth, output, task.model.geometry, WORLD_CLASSES)
        return Drawn(comparison_sheet(parts, WORLD_CLASSES, batch.frame_ids[sample]), parts._asdict())

    def media(self, task: Any, output: Tensor, batch: Batch, sample: int) -> dict[str, list[Named]]:  # noqa: D102
        images, truth = newest_images(batch, sample), batch.voxels[sample].cpu()
        return voxel_media(images, batch.rigs[sample], truth, output, task.model.geometry, WORLD_CLASSES)


class DepthPictures(FramePictures):
    """Ranges on the cameras' pictures, and as panoramas beside the true ones, of the depth stage."""

    key = "depth"

    def picture(self, task: Any, output: Tensor, batch: Batch, sample: int) -> Drawn:  # noqa: D102
        assert batch.erp_range_m is not None
        sheet = depth_sheet(
            list(newest_images(batch, sample)),
            batch.rigs[sample],
            task.model.panorama,
            output,
            batch.erp_range_m[sample].cpu(),
            batch.frame_ids[sample],
        )
        return Drawn(sheet)

    def media(self, task: Any, output: Tensor, batch: Batch, sample: int) -> dict[str, list[Named]]:  # noqa: D102
        assert batch.erp_range_m is not None
        return range_media(output, batch.erp_range_m[sample].cpu(), task.model.panorama)


class SketchPictures(FramePictures):
    """Candidates over true voxels, before and after dilation, of the sketch stage."""

    key = "sketch"

    def picture(self, task: Any, output: Tensor, batch: Batch, sample: int) -> Drawn:  # noqa: D102
        range_m, valid = (part[sample : sample + 1] for part in panorama(batch))
        with torch.inference_mode():
            chosen = task.model.choose(task.model.logits(range_m, valid))[0].cpu()
        sheet = sketch_sheet(
            list(newest_images(batch, sample)),
            batch.voxels[sample].cpu(),
            chosen,
            output,
            task.model.geometry,
            WORLD_CLASSES,
            task.model.panorama,
            range_m[0].masked_fill(~valid[0], torch.nan).cpu(),
            batch.frame_ids[sample],
        )
        return Drawn(sheet)


def newest_images(batch: Batch, sample: int) -> np.ndarray:
    """(N, H, W, 3) uint8 RGB of the newest frame of a sample's window."""
    return batch.images[sample, -1].permute(0, 2, 3, 1).cpu().numpy()
