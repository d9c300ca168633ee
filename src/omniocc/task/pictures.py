"""Pictures of test frames: what the cameras saw, true beside predicted voxels."""

from pathlib import Path
from typing import Any

from lightning.pytorch import Callback, LightningModule, Trainer
from lightning.pytorch.loggers import WandbLogger
from torch import Tensor

from omniocc.batch import Batch
from omniocc.view import comparison, save_png


class Pictures(Callback):
    """Draws `count` frames spread evenly over the test set, and the first validation frame after each validation.

    Files go to `folder` (`test-00-<scene>-<frame>.png`), and to W&B where it is in use.
    """

    def __init__(self, folder: Path, count: int):
        self.folder = folder
        self.count = count

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
            self._draw(trainer, pl_module, "val", f"val-step{trainer.global_step:06d}", outputs, batch, 0)

    def on_test_batch_end(  # noqa: D102
        self,
        trainer: Trainer,
        pl_module: LightningModule,
        outputs: Any,
        batch: Batch,
        batch_idx: int,
        dataloader_idx: int = 0,
    ) -> None:
        if not trainer.is_global_zero:
            return
        size = trainer.test_dataloaders.batch_size  # type: ignore[union-attr]
        total = len(trainer.test_dataloaders.dataset)  # type: ignore[union-attr, arg-type]
        chosen = sorted({round(k * (total - 1) / max(1, self.count - 1)) for k in range(self.count)})
        for sample, frame_id in enumerate(batch.frame_ids):
            index = batch_idx * size + sample
            if index in chosen:
                name = f"test-{chosen.index(index):02d}-{frame_id.replace('/', '-')}"
                self._draw(trainer, pl_module, "test", name, outputs, batch, sample)

    def _draw(
        self, trainer: Trainer, task: LightningModule, stage: str, name: str, labels: Tensor, batch: Batch, sample: int
    ) -> None:
        picture = comparison(
            batch.images[sample, -1].permute(0, 2, 3, 1).cpu().numpy(),
            batch.voxels[sample].cpu(),
            labels[sample].cpu(),
            task.model.geometry,  # type: ignore[union-attr, arg-type]
            caption=batch.frame_ids[sample],
        )
        self.folder.mkdir(parents=True, exist_ok=True)
        save_png(self.folder / f"{name}.png", picture)
        for logger in trainer.loggers:
            if isinstance(logger, WandbLogger):
                logger.log_image(f"{stage}/voxels", [picture], caption=[batch.frame_ids[sample]])
