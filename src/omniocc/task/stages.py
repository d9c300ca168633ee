"""The stages before occupancy: depth, then the sketch of candidate voxels.

The results of a stage are in `runs/stages/<stage>-<hash>`: weights, figures, predictions of every frame. The hash
covers everything that decides them, so that runs share them safely; a lock lets parallel runs wait for one another.
Candidates are in a subfolder, so that runs that select them in different ways share the weights of the sketch.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from functools import partial
from pathlib import Path
from time import time
from typing import Any, cast

import torch
from filelock import FileLock, Timeout
from lightning.pytorch import Trainer, seed_everything
from lightning.pytorch.callbacks import Callback
from omegaconf import DictConfig, OmegaConf
from torch import Tensor, nn
from torch.utils.data import DataLoader, Dataset

from omniocc.camera import Rig
from omniocc.camera.parallax import shared_view
from omniocc.config import build, plain
from omniocc.data import CandidateCache, EvidenceCache, Needs, OccupancyData, RangeCache
from omniocc.data.dataset import read_images
from omniocc.data.module import worker_options
from omniocc.data.source import SPLITS, SceneFrames
from omniocc.data.store.frame_cache import FrameCache
from omniocc.errors import UserError
from omniocc.io import atomic_write
from omniocc.model.ops.depth.sphere_net import SphereNet
from omniocc.model.protocols import Depth, learns
from omniocc.progress import Progress, waiting
from omniocc.run.checkpoint import load_checkpoint
from omniocc.run.checkpoint_io import LAST, AtomicCheckpointIO, resumable
from omniocc.run.cost import PEAK, peak_mib
from omniocc.run.distributed import is_first, meet, share
from omniocc.run.folder import IMAGES, METRICS, command_line, git_commit
from omniocc.run.machine import MACHINE, machine
from omniocc.run.results import FINISHED, MINUTES, load_results, save_results, utc_text
from omniocc.run.slots import uses_evidence
from omniocc.run.wandb.loggers import finish
from omniocc.task.build import bare_trainer
from omniocc.task.depth import DepthTask
from omniocc.task.images import DepthImages, SketchImages
from omniocc.task.last import LastCheckpoint
from omniocc.task.progress import StepProgress, TrainingTime
from omniocc.task.sketch import SketchTask, known
from omniocc.task.stage_keys import stage_keys
from omniocc.task.stage_task import Recipe, StageTask
from omniocc.task.start import load_first_weights
from omniocc.task.stop import StopAtSignal

Task = StageTask[nn.Module]
Read = Callable[[SceneFrames, int], tuple[Tensor | None, ...]]
Predict = Callable[..., tuple[Tensor, ...]]
SHARED_AT_M = 10.0
"""Distance at which the fraction of the view is stated that two or more cameras have in common."""
LITTLE_SHARED = 0.05
"""Fraction below which it is said that there is little to compare."""


class Stages:
    """Run the missing stages before occupancy.

    Args:
        cfg: checked configuration with a learned sketch.
        data: of the occupancy stage, prepared; the stages are trained on its scenes and predict for all of them.
    """

    def __init__(self, cfg: DictConfig, data: OccupancyData):
        self.cfg = cfg
        self.fingerprint, self.spec = data.source.fingerprint, data.spec
        self.scenes = [scene for split in SPLITS for scene in data.source.scenes(split)]
        keys = stage_keys(cfg, self.fingerprint)
        stages = Path(cfg.paths.runs) / "stages"
        depth, sketch = stages / f"depth-{keys.depth}", stages / f"sketch-{keys.sketch}"
        panorama = build(cfg.depth).panorama
        self.ranges = RangeCache(depth / "ranges", (panorama.height, panorama.width))
        self.candidates = CandidateCache(sketch / f"candidates-{keys.candidates}", data.geometry.shape)
        self.evidence = EvidenceCache(sketch / "evidence", data.geometry.shape) if uses_evidence(cfg) else None
        self.folders = {"depth": depth, "sketch": sketch}
        self.results = {"depth": depth, "sketch": self.candidates.folder}

    @property
    def finished(self) -> bool:
        """Return whether both stages have their results."""
        return all((folder / METRICS).exists() for folder in self.results.values())

    def run(self, stage: str, title: str) -> dict[str, float]:
        """Run a stage if it is missing and return its test figures."""
        with claimed(self.folders[stage], title) if is_first() else nullcontext():
            recipe: Recipe = build(self.cfg.stages[stage])
            seed_everything(recipe.seed, workers=True, verbose=False)
            if stage == "depth":
                self._run_depth(recipe, title)
            else:
                self._run_sketch(recipe, title)
        meet()
        return load_results(self.results[stage])[1]

    def _run_depth(self, recipe: Recipe, title: str) -> None:
        model = build(self.cfg.depth)
        spheres = cast(Depth, model).rig_spheres(self.scenes[0].rigs[0])
        edges_m = self.spec.range_edges_m
        appearance = None if self.cfg.appearance is None else build(self.cfg.appearance)
        task = DepthTask(model, recipe.optimizer, spheres, edges_m, recipe.seed, plain(self.cfg), appearance)
        drawn = DepthImages(self.results["depth"] / IMAGES, self.cfg.test_images, self.spec.classes)
        if learns(type(model)) and recipe.max_steps and self.scenes[0].erp_range_m(0) is None:
            raise UserError(
                "the training frames have no true ranges, from which depth learns: choose a sketch without depth "
                "(model/sketch=dense), model/depth=sweep, or depth trained elsewhere (stages.depth.weights=... "
                "stages.depth.max_steps=0)"
            )
        if isinstance(model, SphereNet):
            say(matching_line(shared_view(self.scenes[0].rigs[0], SHARED_AT_M * model.panorama.rays())))
        test = Needs(voxels=False, pixel_labels=False, scores=False, panorama=True)
        train = test._replace(camera_ranges=not isinstance(model, SphereNet))  # which learns from the panorama
        self._finish(task, recipe, (train, test), drawn, "depth", title, learns(type(model)))
        if self.cfg.stage == "depth":  # nothing follows that reads the ranges
            return
        read = partial(read_depth_inputs, with_range=cast(Depth, model).NEEDS_TRUE_RANGE)
        self._fill(task, [self.ranges], read, predict_range_m, f"{title}, ranges")

    def _run_sketch(self, recipe: Recipe, title: str) -> None:
        task = SketchTask(build(self.cfg.model.sketch), recipe.optimizer, self.spec.range_edges_m, plain(self.cfg))
        cast(nn.Module, task.sketch.depth).load_state_dict(load_checkpoint(self.folders["depth"] / LAST).model_weights)
        test = Needs(pixel_labels=False, scores=False, depth=self.ranges)
        train = test._replace(images=False)
        drawn = SketchImages(self.results["sketch"] / IMAGES, self.cfg.test_images, self.spec.classes)
        self._finish(task, recipe, (train, test), drawn, "sketch", title, trains=True)
        caches = [self.candidates, *([self.evidence] if self.evidence else [])]
        self._fill(task, caches, partial(read_range, self.ranges), predict_sketched, f"{title}, candidates")

    def sketch_weights(self) -> dict[str, Tensor]:
        """Return the weights of the trained sketch, depth included, as the occupancy model's `sketch` loads them."""
        return load_checkpoint(self.folders["sketch"] / LAST).model_weights

    def _finish(
        self, task: Task, recipe: Recipe, needs: tuple[Needs, Needs], images: Callback, stage: str, title: str,
        trains: bool,
    ) -> None:  # fmt: skip
        """Load the finished task, or finish its training and test."""
        folder, results = self.folders[stage], self.results[stage]
        last = folder / LAST
        if (results / METRICS).exists():
            say(f"{title} is finished: {results}")
            task.model.load_state_dict(load_checkpoint(last).model_weights)
            return
        checkpoint, message = resumable(last) if trains else (None, None)
        if message:
            say(message)
        say(f"{title} {'goes on' if checkpoint else 'begins'}: {folder}")
        data = build(self.cfg.data, window=1, batch_size=recipe.batch_size, seed=recipe.seed)
        data.read_only(*needs)
        duration = TrainingTime()
        trainer = self._trainer(recipe, [duration, images], folder, stage, title)
        if line := load_first_weights(task.model, recipe, stage, checkpoint, task.config):
            say(line)
        metrics = train_and_test(trainer, task, data, checkpoint, trains and recipe.max_steps != 0)
        trainer.save_checkpoint(last)
        meet()
        if trainer.is_global_zero:
            device = trainer.strategy.root_device
            facts = {"seed": recipe.seed, MINUTES: duration.minutes, PEAK: peak_mib(device), MACHINE: machine(device)}
            self._save_figures(stage, metrics, facts | {"steps": trainer.global_step})
            finish(trainer.loggers)

    def _save_figures(self, stage: str, metrics: dict[str, float], facts: dict[str, Any]) -> None:
        """Write the figures of a stage with facts about its training; they mark it as finished."""
        about = {"run": self.folders[stage].name, "preset": self.cfg.preset.name, "command": command_line()}
        about |= {"commit": git_commit(), "data": self.fingerprint, FINISHED: utc_text(time())}
        save_results(self.results[stage], metrics, about | facts)

    def _trainer(self, recipe: Recipe, callbacks: Sequence[Callback], folder: Path, stage: str, title: str) -> Trainer:
        if is_first():
            atomic_write(folder / "config.yaml", OmegaConf.to_yaml(self.cfg, resolve=True))
        steps = self.cfg.checkpoint_every_n_steps
        return build(
            self.cfg.trainer,
            max_steps=recipe.max_steps,
            max_epochs=recipe.max_epochs,
            check_val_every_n_epoch=recipe.validate_every_n_epochs,
            val_check_interval=None,
            plugins=[AtomicCheckpointIO()],
            callbacks=[
                StepProgress(title),
                *callbacks,
                LastCheckpoint(folder / LAST, steps),
                StopAtSignal(folder / LAST),
            ],
            logger=build(self.cfg.logger).build(folder, plain(self.cfg), stage),
            default_root_dir=str(folder),
        )

    def _fill(self, task: Task, caches: Sequence[FrameCache], read: Read, predict: Predict, title: str) -> None:
        """Predict for all frames of the scenes that are missing in one of the caches, on the device that trains.

        `predict` returns one array for each cache, and may return more. Loader processes read the inputs; Lightning has
        moved the task to the CPU. Several processes share the scenes.
        """
        rank, processes = share()
        own = self.scenes[rank::processes]
        absent = {scene.name for cache in caches for scene in cache.missing(own)}
        missing = [scene for scene in own if scene.name in absent]
        if not missing:
            return
        trainer = bare_trainer(self.cfg.trainer)
        device = task.to(trainer.strategy.root_device).eval().device
        inputs = iter(frame_loader(missing, read, self.cfg.data.num_workers))
        with Progress(title, sum(map(len, missing))) as progress, torch.inference_mode():
            for scene in missing:
                frames = []
                for frame in range(len(scene)):
                    predicted = predict(task, scene.rigs[frame], *batch_of_one(next(inputs), device))
                    frames.append([array.cpu() for array in predicted[: len(caches)]])
                    progress.advance()
                for cache, arrays in zip(caches, zip(*frames, strict=True), strict=True):
                    cache.write(scene.name, arrays)
        task.cpu()


def train_and_test(
    trainer: Trainer, task: Task, data: OccupancyData, checkpoint: Path | None, trains: bool
) -> dict[str, float]:
    """Train a task, from a checkpoint if there is one, and return its figures of validation and test.

    Without `trains` it is scored as it is.
    """
    if trains:
        trainer.fit(task, datamodule=data, ckpt_path=checkpoint and str(checkpoint))
    metrics = dict(trainer.validate(task, datamodule=data, verbose=False)[0])
    if trains:
        task.fit_to_validation()
    metrics |= trainer.test(task, datamodule=data, verbose=False)[0]
    return metrics


def say(text: str) -> None:
    """Print a line in the first process."""
    if is_first():
        print(text, flush=True)


class Frames(Dataset):
    """The inputs of every frame of some scenes, in order."""

    def __init__(self, scenes: Sequence[SceneFrames], read: Read):
        self.frames = [(scene, frame) for scene in scenes for frame in range(len(scene))]
        self.read = read

    def __len__(self) -> int:
        return len(self.frames)

    def __getitem__(self, index: int) -> tuple[Tensor | None, ...]:
        return self.read(*self.frames[index])


def frame_loader(scenes: Sequence[SceneFrames], read: Read, num_workers: int) -> DataLoader[tuple[Tensor | None, ...]]:
    """Return the inputs of every frame of some scenes, in order, read by other processes (0: by this one)."""
    return DataLoader(Frames(scenes, read), batch_size=None, **worker_options(num_workers))


def batch_of_one(inputs: tuple[Tensor | None, ...], device: torch.device) -> list[Tensor | None]:
    """Return tensors as a batch of one on a device."""
    return [None if value is None else value.unsqueeze(0).to(device) for value in inputs]


def matching_line(shared: float) -> str:
    """Return a line about the fraction of directions in which ranges can be measured by comparing cameras."""
    line = f"two or more cameras see {shared:.0%} of what any camera sees, {SHARED_AT_M:g} m away"
    alone = "; elsewhere ranges come from single images, as with model/sketch=mono"
    return line + (alone if shared < LITTLE_SHARED else "")


def read_depth_inputs(scene: SceneFrames, frame: int, with_range: bool) -> tuple[Tensor, Tensor | None]:
    """Return the images of a frame, and the recorded panorama if it is wanted and exists."""
    panorama = scene.erp_range_m(frame) if with_range else None
    return read_images(scene, frame), None if panorama is None else torch.from_numpy(panorama)


def read_range(ranges: RangeCache, scene: SceneFrames, frame: int) -> tuple[Tensor]:
    """Return the predicted panorama of a frame."""
    return (ranges.read(scene.name, frame),)


def predict_range_m(task: DepthTask, rig: Rig, images: Tensor, true_range_m: Tensor | None) -> tuple[Tensor]:
    """Return the predicted panorama of a frame, (h, w), m; nan where unknown."""
    return (task.model(images, (rig,), true_range_m).known_range_m()[0],)


def predict_sketched(task: SketchTask, rig: Rig, range_m: Tensor) -> tuple[Tensor, ...]:
    """Return candidates, and bits of the evidence if there is any, (X, Y, Z) each, from a predicted panorama."""
    return tuple(part[0] for part in task.sketch.hand_on(*known(range_m)) if part is not None)


@contextmanager
def claimed(folder: Path, title: str) -> Iterator[None]:
    """Lock a stage's folder; wait while another process works in it."""
    folder.mkdir(parents=True, exist_ok=True)
    lock = FileLock(folder / ".lock")
    try:
        lock.acquire(timeout=0)
    except Timeout:
        with waiting(title, f"waits for another process that works in {folder}"):
            lock.acquire()
    try:
        yield
    finally:
        lock.release()
