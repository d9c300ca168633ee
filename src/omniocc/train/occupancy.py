"""The occupancy stage: train the model, validate by RayIoU, test it beside a baseline and the true voxels."""

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import torch
from lightning.pytorch import Callback
from lightning.pytorch.callbacks import EMAWeightAveraging
from torch import Tensor, nn

from omniocc.batch import Batch, to_device
from omniocc.camera import Rig
from omniocc.classes import FREE, UNKNOWN
from omniocc.data import Augment, SourceSpec
from omniocc.errors import UserError
from omniocc.loss import TotalLoss
from omniocc.model import OccupancyModel, Prediction, Stream, labels_of
from omniocc.model.protocols import Sketched
from omniocc.runs.scenes import Counted
from omniocc.scores import Scores
from omniocc.train.adamw import AdamW, factor_of
from omniocc.train.scene_counts import SceneCounts
from omniocc.train.sketch import rays_of
from omniocc.train.stage_task import StageTask, log_terms, step_generator


class OccupancyTask(StageTask[OccupancyModel]):
    """Train `model` with `loss`; baseline and true voxels of the test are scored in the same pass.

    * `prior`, the baseline: the most frequent training class of every voxel, which needs no images.
    * `label`: the true voxels themselves, scored against the true LiDAR rays.

    Other arguments as in `StageTask`.

    Args:
        augment: random changes of training batches.
        ema_decay: of the moving average of weights that is validated, tested and saved, such as 0.999; None: none.
        spec: of the data: classes, bands and LiDAR rays of the scores.
        lr_multipliers: of the learning rate, by parts of the model, such as `{"backbone": 0.1}`; a part with 0 keeps
            its weights and its statistics of batch norm.
        occupied_above: probability above which a cell is occupied in validation and test; see `labels_of`.
        seed: of the random changes.

    Raises:
        UserError: when the model has no such part, a factor is negative, or nothing is left to train.
    """

    STAGE = "occupancy"

    def __init__(
        self,
        model: OccupancyModel,
        loss: TotalLoss,
        optimizer: AdamW,
        augment: Augment,
        ema_decay: float | None,
        spec: SourceSpec,
        config: dict[str, Any],
        lr_multipliers: Mapping[str, float],
        occupied_above: float | None,
        seed: int,
    ):
        super().__init__(model, optimizer, config)
        self.lr_multipliers, self.occupied_above, self.seed = lr_multipliers, occupied_above, seed
        self.fixed = fixed_parts(model, lr_multipliers)
        self.train()
        self.loss = loss
        self.augment = augment
        self.ema_decay = ema_decay
        self.stream = Stream(model)
        self.scores = Scores(model.geometry, spec)
        self.prior_scores = Scores(model.geometry, spec)
        self.label_scores = Scores(model.geometry, spec)
        self.by_scene = SceneCounts(self.scores)
        self.counted: dict[str, Counted] = {}
        """Counts of every scene of the last test, of all processes; see `SceneCounts`."""
        self.protocol: dict[str, str] = {}
        """How the scores that were logged last were counted; see `Scores.protocol`."""
        self.prior: Tensor
        self.register_buffer("prior", torch.zeros(model.geometry.shape, dtype=torch.uint8))

    def train(self, mode: bool = True) -> "OccupancyTask":
        """Set the mode, but that of fixed parts, which stay in evaluation."""
        super().train(mode)
        for part in self.fixed:
            part.training = False
        return self

    def set_training_statistics(self, voxel_counts: Tensor) -> None:
        """Set class weights, prior and first logits from the number of training frames with each class in each cell.

        Args:
            voxel_counts: (C, *shape).
        """
        self.model.classifier.set_class_counts(voxel_counts)
        self.loss.set_class_counts(voxel_counts.flatten(1).sum(1))
        self.prior.copy_(voxel_counts.argmax(0))

    def predict(self, batch: Batch) -> Prediction:
        """Return logits of the newest frame, and of ranges where the batch has true ones."""
        with_ranges = batch.camera_range_m is not None
        return self.model(*model_inputs(batch), batch.exists, with_ranges)

    def evaluate(self, batch: Batch) -> Tensor:
        """Return the class of every cell, (B, *shape) uint8; volumes of frames evaluated before are reused."""
        exists = batch.exists
        if exists is None:
            exists = torch.ones(batch.images.shape[:2], dtype=torch.bool, device=batch.images.device)
        logits = self.stream.windows(*model_inputs(batch), exists, batch.frame_ids)
        return labels_of(logits, self.occupied_above)

    def configure_callbacks(self) -> list[Callback]:
        """Return the callback for the moving average of the weights, if there is one."""
        # buffers are those of the last step: averaging would round the prior's class ids
        return [] if self.ema_decay is None else [EMAWeightAveraging(decay=self.ema_decay, use_buffers=False)]

    def training_step(self, batch: Batch, batch_index: int) -> Tensor:
        """Return the sum of the loss terms; each is logged by name."""
        generator = step_generator(self, self.seed, batch_index)
        batch = self.augment(batch, generator)
        prediction = self.predict(batch)
        terms = self.loss(prediction, batch.voxels, batch.pixel_labels, batch.camera_range_m)
        return log_terms(self, terms | self.loss.ray_terms(prediction.logits, rays_of(batch), generator), batch)

    def validation_step(self, batch: Batch, batch_index: int) -> Tensor:
        """Score a batch and return the predicted labels."""
        labels = self.evaluate(batch)
        self.scores.update(labels, batch)
        return labels

    def on_validation_epoch_start(self) -> None:
        """Drop the volumes of past frames, since the weights have changed."""
        self.stream.reset()

    def on_test_epoch_start(self) -> None:
        """Drop the volumes of past frames, and the counts of scenes of an earlier test."""
        self.stream.reset()
        self.by_scene.reset()

    def test_step(self, batch: Batch, batch_index: int) -> Tensor:
        """Score a batch with baseline and true voxels on it, and return the predicted labels."""
        labels = self.validation_step(batch, batch_index)
        self.by_scene.update(labels, batch)
        self.prior_scores.update(self.prior.expand_as(labels), batch)
        # unknown cells are scored as free
        if batch.voxels is not None:
            self.label_scores.update(batch.voxels.masked_fill(batch.voxels == UNKNOWN, FREE), batch)
        return labels

    def log_scores(self, split: str) -> None:
        """Log `<split>/...`, and after a test `prior/...` and `label/...`; drop the volumes of past frames."""
        self.stream.reset()
        self.protocol = self.scores.protocol()
        rows = {split: self.scores}
        if split == "test":
            self.counted = self.by_scene.of_all()
            rows |= {"prior": self.prior_scores, "label": self.label_scores}
        for name, scores in rows.items():
            self.log_dict({f"{name}/{key}": value for key, value in scores.compute().items()}, sync_dist=False)
            scores.reset()


@torch.inference_mode()
def predictions(task: OccupancyTask, batches: Iterable[Batch], device: torch.device) -> Iterator[tuple[Batch, Tensor]]:
    """Yield batches on a device, each with the class of every cell; see `OccupancyTask.evaluate`."""
    task.to(device).eval().stream.reset()
    for batch in batches:
        there = to_device(batch, device)
        yield there, task.evaluate(there)
    task.stream.reset()


def fixed_parts(model: nn.Module, factors: Mapping[str, float]) -> tuple[nn.Module, ...]:
    """Return the parts of a model whose factor of the learning rate is 0; their parameters get no gradients.

    Raises:
        UserError: when the model has no such part, a factor is negative, or nothing is left to train.
    """
    parts = dict(model.named_modules())
    for name, factor in factors.items():
        if name not in parts or not name:
            known = ", ".join(part for part, _ in model.named_children())
            raise UserError(f"lr_multipliers.{name}: the model has no such part; it has {known}, and their parts")
        if factor < 0:
            raise UserError(f"lr_multipliers.{name}={factor}: give 0 (the part stays as it is) or more")
    for name, parameter in model.named_parameters():
        if factor_of(name, factors) == 0:
            parameter.requires_grad_(False)
    if not any(parameter.requires_grad for parameter in model.parameters()):
        raise UserError("lr_multipliers: nothing of the model is left to train")
    return tuple(part for name, part in parts.items() if name and factor_of(name, factors) == 0)


def model_inputs(batch: Batch) -> tuple[Tensor, tuple[tuple[Rig, ...], ...], Tensor, Sketched | None]:
    """Return images, rigs of every frame, poses, and the results of the sketch stage, None where it has not run."""
    sketched = None if batch.candidates is None else Sketched(batch.candidates, batch.evidence)
    return batch.images, batch.rigs, batch.world_from_ego, sketched
