"""One stage of training: depth, sketch or occupancy. `Stage.run` trains and tests all three in the same way."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from contextlib import AbstractContextManager
from functools import cached_property
from pathlib import Path
from time import time
from typing import Any, ClassVar, NamedTuple

from lightning.pytorch import Trainer, seed_everything
from lightning.pytorch.callbacks import Callback
from omegaconf import OmegaConf

from omniocc.camera import Rig
from omniocc.classes import OCCUPANCY_CLASSES, ONE_CLASS
from omniocc.data import Needs, OccupancyData
from omniocc.data.source.cameras import first_rig
from omniocc.errors import FAULTS, UserError, moved_by, reason_of
from omniocc.io import atomic_write
from omniocc.loss import TotalLoss
from omniocc.parts import Parts
from omniocc.runs.checkpoint import load_checkpoint
from omniocc.runs.checkpoint_io import BEST, LAST
from omniocc.runs.cost import PEAK, peak_mib
from omniocc.runs.distributed import barrier, is_first
from omniocc.runs.folder import command_line, git_commit, made_by_other_code
from omniocc.runs.machine import MACHINE, machine
from omniocc.runs.plan import Amount, validation_times
from omniocc.runs.results import (
    FINISHED,
    METRICS,
    MINUTES,
    load_results,
    save_results,
    show_results,
    utc_text,
)
from omniocc.runs.wandb.loggers import finish
from omniocc.train.callbacks import LastCheckpoint, StepProgress, StopAtSignal, TrainingTime
from omniocc.train.checkpoint_plugin import AtomicCheckpointIO
from omniocc.train.data_module import DataModule
from omniocc.train.every_frame import FrameOutputs
from omniocc.train.stage_task import Recipe, StageTask


class Place(NamedTuple):
    """Where a stage reads and writes its files.

    Attributes:
        folder: holds checkpoints and curves.
        checkpoint: its training goes on from this file; None if it begins.
        results: folder that holds the figures of the test.
    """

    folder: Path
    checkpoint: Path | None
    results: Path

    @property
    def finished(self) -> bool:
        """Return whether the stage has been trained and tested."""
        return (self.results / METRICS).exists()


class Stage(ABC):
    """Train a model and test it. A subclass says what is trained, what is read for it, and what later stages get.

    Args:
        parts: builds the objects of the checked configuration.
        data: prepared scenes; the stage is trained on some and predicts for all of them.
        earlier: the earlier stages, in order.
        has_reader: whether a later stage reads the outputs of this one.

    Attributes:
        NAME: name of the stage, as in `conf/stages`.
        recipe: how it is trained.
        window: number of frames of a sample.
        learns: whether there is anything to train.
        TESTS_BEST: whether the best checkpoint is tested, which one of `callbacks` saves, instead of the last weights.
        FINISHED_HINT: end of the line that says that the stage is finished.
    """

    NAME: ClassVar[str]
    TESTS_BEST: ClassVar[bool] = False
    FINISHED_HINT: ClassVar[str] = ""
    window = 1
    learns = True

    def __init__(self, parts: Parts, data: OccupancyData, earlier: "Sequence[Stage]" = (), has_reader: bool = False):
        self.parts, self.data, self.has_reader = parts, data, has_reader
        self.earlier = {stage.NAME: stage for stage in earlier}
        self.recipe: Recipe = parts.recipe(self.NAME)

    @cached_property
    @abstractmethod
    def key(self) -> str:
        """Return a hash of everything that decides the results."""

    @abstractmethod
    def lock(self, title: str) -> AbstractContextManager[Place]:
        """Lock the stage's folder within the context; give its place, with the checkpoint to go on from."""

    @abstractmethod
    def task(self, rig: Rig) -> StageTask:
        """Return the task with new weights; `rig` is the rig of the first training frame."""

    @abstractmethod
    def needs(self, task: StageTask) -> tuple[Needs, Needs]:
        """Return what is read of a sample in training, then what is read in validation and test."""

    @abstractmethod
    def callbacks(self, place: Place, data: OccupancyData) -> list[Callback]:
        """Return the callbacks of this stage, such as one that draws test frames."""

    @abstractmethod
    def cost(self, task: StageTask, data: OccupancyData) -> dict[str, float]:
        """Return the number of parameters, and the operations for one frame."""

    @abstractmethod
    def initialize(self, task: StageTask, data: OccupancyData, checkpoint: Path | None) -> str | None:
        """Give the task its first weights; return a line about weights that the recipe names, or None."""

    def figures_and_facts(
        self, task: StageTask, data: OccupancyData, trainer: Trainer, place: Place
    ) -> tuple[dict[str, float], dict[str, Any]]:
        """Return further figures and facts of a finished test; only the first process calls this."""
        return {}, {}

    def outputs(self) -> FrameOutputs | None:
        """Return what is predicted for every frame and kept for later stages; None if nothing is."""
        return None

    def ray_needs(self, loss: TotalLoss) -> dict[str, Any]:
        """Return what training reads for a loss that learns from measured rays, fields of `Needs`; none for others."""
        if loss.rays is None:
            return {}
        votes = self.data.ray_votes(loss.rays) if loss.needs_voxels else None
        return {"voxels": loss.needs_voxels, "votes": votes, "rays": loss.rays if len(loss.lidar) else None}

    def amount(self, frames: int, trainer: Trainer) -> Amount:
        """Return how much training the recipe asks for, given the number of training frames."""
        recipe, devices = self.recipe, trainer.num_devices * trainer.num_nodes
        batches = trainer.accumulate_grad_batches, trainer.limit_train_batches
        return Amount(recipe.max_steps, recipe.max_epochs, frames, recipe.batch_size, devices, *batches)

    @moved_by("paths.runs")
    def run(self, title: str) -> dict[str, float]:
        """Train and test unless that is done, predict what later stages read, and return the figures."""
        with self.lock(title) as place:
            outputs = self.outputs() if self.has_reader else None
            missing = outputs.missing() if outputs else []
            if place.finished:
                announce(f"{title} is finished: {place.results}{made_by_other_code(place.results)}{self.FINISHED_HINT}")
            if not place.finished or missing:
                seed_everything(self.recipe.seed, workers=True, verbose=False)
                task = self.task(first_rig(self.data.source))
                if place.finished:
                    task.model.load_state_dict(load_checkpoint(place.folder / LAST).model_weights)
                else:
                    self.train(task, place, title)
                if outputs is not None and missing:
                    device = self.parts.trainer().strategy.root_device
                    outputs.fill(missing, task, device, self.data.num_workers, title)
        barrier()
        facts, metrics = load_results(place.results)
        if is_first():
            show_results(place.results)
            if (name := facts.get("checkpoint")) is not None:
                print(f"weights   {place.folder / name}", flush=True)
        return metrics

    def train(self, task: StageTask, place: Place, title: str) -> None:
        """Train from the start or a checkpoint, test, and write figures and facts about the training."""
        recipe, last, cfg = self.recipe, place.folder / LAST, self.parts.cfg
        if is_first():
            atomic_write(place.folder / "config.yaml", OmegaConf.to_yaml(cfg, resolve=True))
        data = self.parts.data(window=self.window, batch_size=recipe.batch_size, seed=recipe.seed)
        data.set_needs(*self.needs(task))
        data.setup()  # `initialize` counts classes in the training frames; a second call, by Lightning, changes nothing
        weights_line = self.initialize(task, data, place.checkpoint)
        duration = TrainingTime()
        trainer = self.parts.trainer(
            max_steps=recipe.max_steps,
            max_epochs=recipe.max_epochs,
            **validation_times(
                recipe.max_steps, recipe.max_epochs, recipe.validate_every_n_epochs, cfg.trainer.accumulate_grad_batches
            ),
            callbacks=[
                StepProgress(title),
                duration,
                *self.callbacks(place, data),
                LastCheckpoint(last, cfg.checkpoint_every_n_steps),
                StopAtSignal(last, *([f"resume={last} goes on"] if cfg.resume == "never" else [])),
            ],
            plugins=[AtomicCheckpointIO()],
            logger=self.parts.loggers().build(place.folder, self.parts.config, self.NAME),
            default_root_dir=str(place.folder),
        )
        if trainer.is_global_zero:
            announce_stage(title, task, data, place, weights_line)
        trains, module = self.learns and recipe.max_steps != 0, DataModule(data)
        if trains:
            try:
                trainer.fit(task, datamodule=module, ckpt_path=place.checkpoint and str(place.checkpoint))
            except FAULTS as error:
                if place.checkpoint is None or duration.began or isinstance(error, UserError):
                    raise
                reason = f"training cannot go on from it ({reason_of(error)}); move it elsewhere to train anew"
                raise UserError(f"{place.checkpoint} is damaged or of another version: {reason}") from error
        minutes, tested_checkpoint = duration.minutes, None  # now: a checkpoint loaded for the test brings its own time
        if trains and self.TESTS_BEST:
            trainer.save_checkpoint(last)
            tested_checkpoint = str(best if (best := place.folder / BEST).exists() else last)
        metrics = dict(trainer.validate(task, datamodule=module, ckpt_path=tested_checkpoint, verbose=False)[0])
        if trains:
            task.fit_to_validation()
        metrics |= trainer.test(task, datamodule=module, ckpt_path=tested_checkpoint, verbose=False)[0]
        if tested_checkpoint is None:
            trainer.save_checkpoint(last)
        barrier()
        if not trainer.is_global_zero:
            return
        device = trainer.strategy.root_device
        facts = {"run": place.folder.name, "checkpoint": Path(tested_checkpoint or last).name, "seed": recipe.seed}
        facts |= {"steps": trainer.global_step, "preset": cfg.preset.name, "command": command_line()}
        facts |= {MINUTES: minutes, PEAK: peak_mib(device), MACHINE: machine(device), **self.cost(task, data)}
        further_figures, further_facts = self.figures_and_facts(task, data, trainer, place)
        facts |= {**further_facts, "commit": git_commit(), "data": data.source.fingerprint, FINISHED: utc_text(time())}
        save_results(place.results, metrics | further_figures, facts)
        finish(trainer.loggers)


def announce_stage(title: str, task: StageTask, data: OccupancyData, place: Place, weights_line: str | None) -> None:
    """Print a line each on the folder, the model, the first weights (unless `weights_line` is None) and the data."""
    parameters = sum(p.numel() for p in task.model.parameters()) / 1e6
    start = "begins" if place.checkpoint is None else f"goes on from {place.checkpoint.name}"
    announce(f"{title} {start}: {place.folder}")
    grid = data.geometry
    shape = f"{type(grid).__name__} {'x'.join(map(str, grid.shape))}"
    announce(f"model     {parameters:.2f} M parameters, {type(task.model).__name__}, {shape}")
    if weights_line is not None:
        announce(f"weights   {weights_line}")
    announce(f"data      {data.source.folder}")
    if data.num_classes == OCCUPANCY_CLASSES.num_classes:
        announce(f"classes   {ONE_CLASS}")


def announce(text: str) -> None:
    """Print a line, in the first process only."""
    if is_first():
        print(text, flush=True)
