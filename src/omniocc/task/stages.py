"""The stages before occupancy: depth, then the sketch of candidate voxels.

What a stage leaves lies in `runs/stages/<stage>-<hash>`: weights, figures, what it says about every frame. The hash
covers everything that made it, so that runs share it and never mix it up; a lock lets parallel runs wait for one
another. What depends on how a sketch chooses among its probabilities lies one folder deeper, so that runs that choose
in other ways share its weights.
"""

import hashlib
import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import torch
from filelock import FileLock, Timeout
from lightning.pytorch import LightningModule, Trainer, seed_everything
from lightning.pytorch.callbacks import Callback, ModelCheckpoint
from omegaconf import DictConfig, OmegaConf
from torch import Tensor

from omniocc.config import build, plain
from omniocc.data import CandidateCache, Extras, OccupancyData, RangeCache
from omniocc.data.dataset import read_images, read_true_ranges
from omniocc.data.source import SPLITS, SceneFrames
from omniocc.data.store.frame_cache import FrameCache
from omniocc.errors import UserError
from omniocc.io import atomic_write
from omniocc.model.occupancy import to_unit_range
from omniocc.model.ops.depth.spheres import rig_spheres
from omniocc.progress import Progress, waiting
from omniocc.run.checkpoint_io import LAST, AtomicCheckpointIO, resumable
from omniocc.run.folder import METRICS, PICTURES, git_commit
from omniocc.run.results import load_results, save_results
from omniocc.run.wandb.loggers import finish
from omniocc.task.checkpoint import load_config, model_weights
from omniocc.task.depth import Depth
from omniocc.task.pictures import DepthPictures, SketchPictures
from omniocc.task.progress import StepProgress
from omniocc.task.recipe import Recipe
from omniocc.task.sketch import Sketch, known

STAGES = ("depth", "sketch", "occupancy")
VERSIONS = {"depth": 3, "sketch": 1, "candidates": 1}
"""Raise a number when the same configuration would give another result."""

SELECTION = ("threshold", "share", "windows", "band_edges_m")
"""Arguments of a sketch that choose among its probabilities; its weights do not depend on them."""

OVERRULED = ("max_steps", "check_val_every_n_epoch", "devices", "strategy", "accelerator")
"""Trainer options that a stage sets by itself, or that do not change what it learns."""


def is_learned(cfg: DictConfig) -> bool:
    """Whether the sketch looks at a panorama of ranges, so that there are stages before occupancy."""
    return "depth" in cfg.model.sketch


def wanted_stages(cfg: DictConfig) -> tuple[str, ...]:
    """Stages up to the one asked for (`stage=...`), in order.

    Raises:
        UserError: for an unknown stage, or one that the model does not have.
    """
    stage = cfg.stage or "occupancy"
    if stage not in STAGES:
        raise UserError(f"stage={stage}: choose one of {', '.join(STAGES)}; leave it out to run what is missing")
    present = STAGES if is_learned(cfg) else STAGES[-1:]
    if stage not in present:
        raise UserError(f"stage={stage}: this sketch needs no such stage; choose model/sketch=omni or mono")
    return present[: present.index(stage) + 1]


def digest(content: Any) -> str:
    """Eight hex digits of plain data."""
    return hashlib.sha256(json.dumps(content, sort_keys=True, default=str).encode()).hexdigest()[:8]


class Keys(NamedTuple):
    """Hashes of everything that makes what a stage leaves."""

    depth: str
    sketch: str
    candidates: str


def stage_keys(cfg: DictConfig, data_fingerprint: str) -> Keys:
    """Hashes for a configuration with a learned sketch."""
    config = plain(cfg)
    trainer = {key: value for key, value in config["trainer"].items() if key not in OVERRULED}
    sketch = {k: v for k, v in config["model"]["sketch"].items() if k not in ("depth", *SELECTION)}
    selection = [config["model"]["sketch"].get(name) for name in SELECTION]
    stages = config["stages"]
    depth_key = digest([VERSIONS["depth"], config["depth"], stages["depth"], trainer, data_fingerprint])
    labels = config["data"]["unknown"]
    sketch_key = digest([VERSIONS["sketch"], depth_key, sketch, stages["sketch"], trainer, labels])
    return Keys(depth_key, sketch_key, digest([VERSIONS["candidates"], sketch_key, selection]))


class Stages:
    """Runs what is missing of the stages before occupancy.

    Args:
        cfg: checked configuration with a learned sketch.
        data: of the occupancy stage, prepared; its scenes are what the stages learn from and speak about.
    """

    def __init__(self, cfg: DictConfig, data: OccupancyData):
        self.cfg = cfg
        self.fingerprint, self.spec = data.source.fingerprint, data.source.spec
        self.scenes = [scene for split in SPLITS for scene in data.source.scenes(split)]
        keys = stage_keys(cfg, self.fingerprint)
        stages = Path(cfg.paths.runs) / "stages"
        self.depth, self.sketch = stages / f"depth-{keys.depth}", stages / f"sketch-{keys.sketch}"
        width, height = cfg.depth.erp_size
        self.ranges = RangeCache(self.depth / "ranges", (height, width))
        self.candidates = CandidateCache(self.sketch / f"candidates-{keys.candidates}", data.geometry.shape)
        self.results = {"depth": self.depth, "sketch": self.candidates.folder}

    def run(self, stage: str, title: str) -> dict[str, float]:
        """Run a stage if it is missing; returns the figures of its test."""
        return {"depth": self.run_depth, "sketch": self.run_sketch}[stage](title)

    def run_depth(self, title: str) -> dict[str, float]:
        """Train and test the depth slot, then predict the panorama of every frame; returns the test's figures."""
        with claimed(self.depth, title):
            recipe = self._recipe("depth")
            model = build(self.cfg.depth)
            spheres = rig_spheres(
                self.scenes[0].rigs[0], model.panorama, self.cfg.depth.spheres, self.cfg.depth.min_range_m
            )
            task = Depth(model, recipe.optimizer, spheres, self.spec.range_edges_m, recipe.seed, plain(self.cfg))
            trains = hasattr(model, "training_terms")
            drawn = DepthPictures(self.results["depth"] / PICTURES, self.cfg.pictures)
            self._finish(task, recipe, Extras(true_ranges=True), drawn, "depth", title, trains)
            self._fill(self.ranges, lambda scene, frame: predict_range_m(task, scene, frame), f"{title}, ranges")
        return load_results(self.results["depth"])[1]

    def run_sketch(self, title: str) -> dict[str, float]:
        """Train and test the sketch on predicted panoramas, then choose every frame's candidates; returns figures."""
        with claimed(self.sketch, title):
            recipe = self._recipe("sketch")
            task = Sketch(build(self.cfg.model.sketch), recipe.optimizer, self.spec.range_edges_m, plain(self.cfg))
            task.model.depth.load_state_dict(weights_of(self.depth / LAST))
            extras = Extras(true_ranges=True, depth=self.ranges)
            drawn = SketchPictures(self.results["sketch"] / PICTURES, self.cfg.pictures)
            self._finish(task, recipe, extras, drawn, "sketch", title, trains=True)
            self._fill(self.candidates, lambda scene, frame: self._choose(task, scene, frame), f"{title}, candidates")
        return load_results(self.results["sketch"])[1]

    def sketch_weights(self) -> dict[str, Tensor]:
        """Weights of the trained sketch, depth included, as the occupancy model's `sketch` loads them."""
        return weights_of(self.sketch / LAST)

    def _recipe(self, stage: str) -> Recipe:
        recipe: Recipe = build(self.cfg.stages[stage])
        seed_everything(recipe.seed, workers=True, verbose=False)
        return recipe

    def _finish(
        self,
        task: LightningModule,
        recipe: Recipe,
        extras: Extras,
        pictures: Callback,
        stage: str,
        title: str,
        trains: bool,
    ) -> None:
        """Leave the task trained and tested: by loading it, or by what is left of training and testing."""
        folder, results = {"depth": self.depth, "sketch": self.sketch}[stage], self.results[stage]
        last = folder / LAST
        if (results / METRICS).exists():
            print(f"{title} is there: {results}", flush=True)
            task.model.load_state_dict(weights_of(last))  # type: ignore[union-attr]
            return
        checkpoint, mishap = resumable(last) if trains else (None, None)
        if mishap:
            print(mishap, flush=True)
        print(f"{title} {'goes on' if checkpoint else 'begins'}: {folder}", flush=True)
        data = build(self.cfg.data, window=1, batch_size=recipe.batch_size, seed=recipe.seed)
        data.read_also(extras)
        trainer = self._trainer(recipe, pictures, folder, stage, title)
        if trains:
            trainer.fit(task, datamodule=data, ckpt_path=checkpoint and str(checkpoint))
        metrics = trainer.test(task, datamodule=data, verbose=False)[0]
        trainer.save_checkpoint(last)
        facts = {"run": folder.name, "steps": trainer.global_step, "seed": recipe.seed, "commit": git_commit()}
        results.mkdir(parents=True, exist_ok=True)
        save_results(results, metrics, facts | {"data": self.fingerprint})
        finish(trainer.loggers)

    def _trainer(self, recipe: Recipe, pictures: Callback, folder: Path, stage: str, title: str) -> Trainer:
        atomic_write(folder / "config.yaml", OmegaConf.to_yaml(self.cfg, resolve=True))
        steps = self.cfg.checkpoint_every_n_steps
        return build(
            self.cfg.trainer,
            max_steps=recipe.max_steps,
            check_val_every_n_epoch=recipe.validate_every_n_epochs,
            devices=1,
            strategy="auto",
            plugins=[AtomicCheckpointIO()],
            callbacks=[
                StepProgress(title),
                pictures,
                ModelCheckpoint(folder, "last", every_n_train_steps=steps, enable_version_counter=False),
            ],
            logger=build(self.cfg.logger).build(folder, plain(self.cfg), stage),
            default_root_dir=str(folder),
        )

    def _choose(self, task: Sketch, scene: SceneFrames, frame: int) -> Tensor:
        range_m = self.ranges.read(scene.name, frame).unsqueeze(0).to(task.device)
        return task.model.select(task.model.logits(*known(range_m)))[0]

    def _fill(self, cache: FrameCache, predict: Callable[[SceneFrames, int], Tensor], title: str) -> None:
        missing = cache.missing(self.scenes)
        with Progress(title, sum(map(len, missing))) as progress, torch.inference_mode():
            for scene in missing:
                arrays = []
                for frame in range(len(scene)):
                    arrays.append(predict(scene, frame))
                    progress.advance()
                cache.write(scene.name, arrays)


def predict_range_m(task: Depth, scene: SceneFrames, frame: int) -> Tensor:
    """(h, w) predicted panorama of a recorded frame, nan where nothing is known."""
    images = to_unit_range(read_images(scene, frame).unsqueeze(0).to(task.device))
    panorama = read_true_ranges(scene, frame)[0]
    true_range_m = None if panorama is None else panorama.unsqueeze(0).to(task.device)
    depth = task.eval().model(images, (scene.rigs[frame],), true_range_m)
    return depth.known_range_m()[0]


def weights_of(path: Path) -> dict[str, Tensor]:
    """Weights of the model of a stage's checkpoint.

    Raises:
        FileNotFoundError, UserError: see `load_config`.
    """
    return model_weights(load_config(path)[1])


@contextmanager
def claimed(folder: Path, title: str) -> Iterator[None]:
    """Hold a stage's folder; waits while another process works in it."""
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
