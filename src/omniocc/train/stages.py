"""The three stages: depth, the sketch of candidate voxels, and occupancy.

The results of depth and sketch are in `runs/stages/<stage>-<hash>`: weights, figures, predictions of every frame. The
hash covers everything that decides them, so that runs share them safely; a lock lets parallel runs wait for one
another. Candidates are in a subfolder, so that runs that select them in different ways share the weights of the sketch.
What networks predict that are used as they are is beside the stages, and shared by runs on any data.
"""

from abc import abstractmethod
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext
from functools import cached_property, partial
from pathlib import Path
from typing import Any, TypeVar, cast

import torch
from lightning.pytorch import Trainer
from lightning.pytorch.callbacks import Callback, ModelCheckpoint
from torch import Tensor, nn

from omniocc.camera import Rig
from omniocc.camera.parallax import shared_view
from omniocc.classes import FREE
from omniocc.data import CandidateCache, EvidenceCache, Needs, OccupancyData, RangeCache
from omniocc.data.dataset import read_images
from omniocc.data.source import SPLITS, SceneFrames
from omniocc.data.store.frame_cache import FrameCache
from omniocc.errors import UserError
from omniocc.lock import Held, acquire
from omniocc.model.protocols import Depth
from omniocc.parts import Parts
from omniocc.progress import show_waiting
from omniocc.runs.checkpoint import load_checkpoint
from omniocc.runs.checkpoint_io import LAST, resumable
from omniocc.runs.cost import cost_of, cost_of_network
from omniocc.runs.distributed import is_first
from omniocc.runs.folder import open_run, run_hash
from omniocc.runs.results import CANDIDATES, EARLIER_MINUTES, IMAGES, MINUTES, PROTOCOL, load_results
from omniocc.runs.slots import depth_learns, uses_evidence
from omniocc.runs.wandb.loggers import log_earlier_stages
from omniocc.train.build import build_task
from omniocc.train.depth import DepthTask
from omniocc.train.every_frame import FrameOutputs
from omniocc.train.images import DepthImages, OccupancyImages, SketchImages
from omniocc.train.occupancy import OccupancyTask
from omniocc.train.scene_counts import save_by_scene
from omniocc.train.sketch import SketchTask, finite_ranges
from omniocc.train.stage import Place, Stage, announce
from omniocc.train.stage_keys import Keys, stage_keys, wanted_stages
from omniocc.train.stage_task import StageTask
from omniocc.train.start import load_first_weights, load_fitting

Cache = TypeVar("Cache", bound=FrameCache)
SHARED_AT_M = 10.0
"""Distance at which the fraction of the view is stated that two or more cameras have in common."""
LITTLE_SHARED = 0.05
"""Fraction below which it is said that there is little to compare."""


class EarlierStage(Stage):
    """A stage before occupancy; its folder is shared by all runs that need the same results."""

    @cached_property
    def keys(self) -> Keys:
        """Return the hashes of both stages."""
        return stage_keys(self.parts.cfg, self.data.source.fingerprint)

    @property
    def key(self) -> str:  # noqa: D102
        return getattr(self.keys, self.NAME)

    @property
    def stages(self) -> Path:
        """Return the folder of all stages."""
        return Path(self.parts.cfg.paths.runs) / "stages"

    @property
    def folder(self) -> Path:
        """Return the folder of weights and curves."""
        return self.stages / f"{self.NAME}-{self.key}"

    @property
    def results(self) -> Path:
        """Return the folder of the figures."""
        return self.folder

    @property
    def scenes(self) -> list[SceneFrames]:
        """Return the scenes of all splits."""
        return [scene for split in SPLITS for scene in self.data.source.scenes(split)]

    @property
    def finished(self) -> bool:
        """Return whether it has been trained and tested."""
        return Place(self.folder, None, self.results).finished

    @contextmanager
    def lock(self, title: str) -> Iterator[Place]:
        """Lock the folder in the first process; wait while another run works in it."""
        with lock_folder(self.folder, title) if is_first() else nullcontext():
            checkpoint, message = (None, None) if self.finished or not self.learns else resumable(self.folder / LAST)
            if message:
                announce(message)
            yield Place(self.folder, checkpoint, self.results)

    def initialize(self, task: StageTask, data: OccupancyData, checkpoint: Path | None) -> str | None:  # noqa: D102
        return load_first_weights(task.model, self.recipe, self.NAME, checkpoint, task.config)

    def store(self, kind: type[Cache], shape: Sequence[int], own: Path, name: str, of_all: str | None) -> Cache:
        """Return a store of arrays of every frame: in the folder `own`, or that of the hash `of_all` for any data."""
        if of_all is None:
            return kind(own, shape)
        return kind(self.stages / f"{name}-{of_all}", shape, self.data.source.fingerprint)

    def weights(self) -> dict[str, Tensor]:
        """Return the trained weights of the model."""
        return load_checkpoint(self.folder / LAST).model_weights

    @abstractmethod
    def outputs(self) -> FrameOutputs:  # noqa: D102
        ...


class DepthStage(EarlierStage):
    """The cameras' images to a panorama of ranges, which every frame gets."""

    NAME = "depth"

    def __init__(self, *arguments: Any, **others: Any):
        super().__init__(*arguments, **others)
        option = cast(Depth, self.parts.depth())
        self.panorama, self.needs_true_range = option.panorama, option.NEEDS_TRUE_RANGE
        self.learns = depth_learns(self.parts.cfg)

    @cached_property
    def ranges(self) -> RangeCache:
        """Return the store of the ranges of every frame."""
        shape = self.panorama.height, self.panorama.width
        return self.store(RangeCache, shape, self.folder / "ranges", "ranges", self.keys.ranges_of_all)

    def task(self, rig: Rig) -> DepthTask:  # noqa: D102
        model = self.parts.depth()
        return DepthTask(
            model,
            self.recipe.optimizer,
            spheres=cast(Depth, model).rig_spheres(rig),
            range_edges_m=self.data.spec.range_edges_m,
            seed=self.recipe.seed,
            config=self.parts.config,
            appearance=self.parts.appearance(),
        )

    def needs(self, task: StageTask) -> tuple[Needs, Needs]:  # noqa: D102
        test = Needs(voxels=False, pixel_labels=False, scores=False, panorama=True)
        return test._replace(camera_ranges=getattr(task.model, "NEEDS_CAMERA_RANGES", True)), test

    def initialize(self, task: StageTask, data: OccupancyData, checkpoint: Path | None) -> str | None:
        """Load the weights that the recipe names.

        Raises:
            UserError: when the network has nothing to learn from.
        """
        scene = data.dataset("train").scenes[0]
        if self.learns and self.recipe.max_steps and scene.erp_range_m(0) is None:
            raise UserError(
                "the training frames have no true ranges, from which depth learns: choose a sketch without depth "
                "(model/sketch=dense), model/depth=sweep, or depth trained elsewhere (stages.depth.weights=... "
                "stages.depth.max_steps=0)"
            )
        if getattr(task.model, "COMPARES_CAMERAS", False):
            announce(matching_line(shared_view(scene.rigs[0], SHARED_AT_M * self.panorama.rays())))
        return super().initialize(task, data, checkpoint)

    def callbacks(self, place: Place, data: OccupancyData) -> list[Callback]:  # noqa: D102
        return [DepthImages(place.results / IMAGES, self.parts.cfg.test_images, data.spec.classes)]

    def cost(self, task: StageTask, data: OccupancyData) -> dict[str, float]:  # noqa: D102
        sample, device = data.dataset("test")[0], next(task.parameters(), torch.empty(0)).device
        true_range_m = None if sample.erp_range_m is None else sample.erp_range_m[None].to(device)
        images = sample.images[-1:].to(device)
        return cost_of_network(task.model, lambda: task.model.eval()(images, sample.rigs[-1:], true_range_m))

    def outputs(self) -> FrameOutputs:  # noqa: D102
        read = partial(read_depth_inputs, with_range=self.needs_true_range)
        return FrameOutputs("ranges", self.scenes, [self.ranges], read, predict_range_m)


class SketchStage(EarlierStage):
    """Panoramas of ranges to candidate voxels, which every frame gets, with what the sketch knows of each voxel."""

    NAME = "sketch"

    @property
    def results(self) -> Path:  # noqa: D102
        return self.folder / f"candidates-{self.keys.candidates}"

    @property
    def depth(self) -> DepthStage:
        """Return the stage before."""
        return cast(DepthStage, self.earlier["depth"])

    @cached_property
    def candidates(self) -> CandidateCache:
        """Return the store of the candidates of every frame."""
        shape = self.data.geometry.shape
        return self.store(CandidateCache, shape, self.results, "candidates", self.keys.candidates_of_all)

    @cached_property
    def evidence(self) -> EvidenceCache | None:
        """Return the store of the evidence of every frame; None where nothing reads it."""
        if not uses_evidence(self.parts.cfg):
            return None
        shape = self.data.geometry.shape
        return self.store(EvidenceCache, shape, self.folder / "evidence", "evidence", self.keys.sketched_of_all)

    def task(self, rig: Rig) -> SketchTask:  # noqa: D102
        edges_m, config = self.data.spec.range_edges_m, self.parts.config
        recipe, loss = self.recipe, self.parts.loss()
        return SketchTask(self.parts.sketch(), recipe.optimizer, edges_m, config, recipe.seed, loss)

    def needs(self, task: StageTask) -> tuple[Needs, Needs]:  # noqa: D102
        test = Needs(pixel_labels=False, scores=False, depth=self.depth.ranges)
        return test._replace(images=False, **self.ray_needs(self.parts.loss())), test

    def initialize(self, task: StageTask, data: OccupancyData, checkpoint: Path | None) -> str | None:
        """Load the weights of the depth stage and those that the recipe names."""
        cast(nn.Module, task.model.depth).load_state_dict(self.depth.weights())
        return super().initialize(task, data, checkpoint)

    def callbacks(self, place: Place, data: OccupancyData) -> list[Callback]:  # noqa: D102
        return [SketchImages(place.results / IMAGES, self.parts.cfg.test_images, data.spec.classes)]

    def cost(self, task: StageTask, data: OccupancyData) -> dict[str, float]:  # noqa: D102
        range_m = data.dataset("test")[0].depth_range_m
        assert range_m is not None
        device = next(task.parameters()).device
        found = finite_ranges(range_m[None].to(device))
        return cost_of_network(task.model, lambda: cast(SketchTask, task.eval()).sketch.propose(*found))

    def outputs(self) -> FrameOutputs:  # noqa: D102
        caches = [self.candidates, *([self.evidence] if self.evidence else [])]
        read = partial(read_range, self.depth.ranges)
        return FrameOutputs("candidates", self.scenes, caches, read, predict_sketched)


class OccupancyStage(Stage):
    """Images and candidates to voxels: the last stage, whose folder is the run's."""

    NAME = "occupancy"
    TESTS_BEST = True
    FINISHED_HINT = "; resume=never trains again beside it"

    @cached_property
    def window(self) -> int:  # type: ignore[override]  # noqa: D102
        return self.data.window

    @cached_property
    def key(self) -> str:  # noqa: D102
        return run_hash(self.parts.config, self.data.source.fingerprint)

    @property
    def sketch(self) -> SketchStage | None:
        """Return the stage before; None without a learned sketch."""
        return cast(SketchStage | None, self.earlier.get("sketch"))

    @contextmanager
    def lock(self, title: str) -> Iterator[Place]:
        """Lock the run's folder; raise UserError when another process works in it."""
        cfg = self.parts.cfg
        run = open_run(Path(cfg.paths.runs), cfg.name, self.key, cfg.resume)
        try:
            yield Place(run.path, run.checkpoint, run.path)
        finally:
            if run.lock is not None:
                run.lock.release()

    def task(self, rig: Rig) -> OccupancyTask:  # noqa: D102
        return build_task(self.parts, self.data.spec)

    def needs(self, task: StageTask) -> tuple[Needs, Needs]:  # noqa: D102
        loss, sketch = cast(OccupancyTask, task).loss, self.sketch
        test = Needs(pixel_labels=False, candidates=sketch and sketch.candidates, evidence=sketch and sketch.evidence)
        learned: dict[str, Any] = {"pixel_labels": len(loss.pixel) > 0, "camera_ranges": len(loss.ray) > 0}
        learned |= self.ray_needs(loss)
        return test._replace(scores=False, **learned), test

    def initialize(self, task: StageTask, data: OccupancyData, checkpoint: Path | None) -> str | None:
        """Load the sketch, count the classes of the training frames, and load what fits of the given weights."""
        assert isinstance(task, OccupancyTask)
        if self.sketch is not None:
            task.model.sketch.load_state_dict(self.sketch.weights())  # type: ignore[union-attr]
        task.set_training_statistics(data.voxel_counts(task.loss))
        if self.recipe.weights is None or checkpoint is not None:
            return None
        return load_fitting(task.model, self.recipe.weights, task.config)

    def callbacks(self, place: Place, data: OccupancyData) -> list[Callback]:
        """Return the user's callbacks, and those that keep the best checkpoint and draw."""
        return [
            *self.parts.callbacks(),
            ModelCheckpoint(place.folder, "best", monitor=score_of(data), mode="max", enable_version_counter=False),
            OccupancyImages(place.folder / IMAGES, self.parts.cfg.test_images, data.spec.classes),
        ]

    def cost(self, task: StageTask, data: OccupancyData) -> dict[str, float]:  # noqa: D102
        return cost_of(cast(OccupancyTask, task).model.eval(), data.dataset("test")[0])

    def figures_and_facts(
        self, task: StageTask, data: OccupancyData, trainer: Trainer, place: Place
    ) -> tuple[dict[str, float], dict[str, Any]]:
        """Return the figures of earlier stages, and facts for the report.

        The fraction of candidates is measured here only if the sketch is not learned; else its stage measures it.
        """
        assert isinstance(task, OccupancyTask)
        before = {name: load_results(cast(EarlierStage, stage).results) for name, stage in self.earlier.items()}
        figures = {name: value for _, known in before.values() for name, value in known.items()}
        log_earlier_stages(trainer.loggers, figures, trainer.global_step)
        save_by_scene(place.folder, task.scores, data.source, task.counted)
        rows, limit = data.spec.classes.rows, trainer.limit_test_batches
        whole = isinstance(limit, float) and limit == 1  # 1 is one batch, 1.0 are all
        tested = "" if whole else f"; trainer.limit_test_batches={limit}"
        facts: dict[str, Any] = {
            "stages": {name: facts["steps"] for name, (facts, _) in before.items()} | {self.NAME: trainer.global_step},
            "classes": [{"name": row.name, "rgb": row.rgb} for row in rows if row.id != FREE],
            EARLIER_MINUTES: round(sum(facts.get(MINUTES, 0.0) for facts, _ in before.values()), 1),
            PROTOCOL: {kind: f"{text}{tested}" for kind, text in task.protocol.items()},
        }
        if self.sketch is None:
            sample = data.dataset("test")[0]
            chosen = task.model.propose(sample.images[-1:].to(task.device), sample.rigs[-1:]).candidates
            facts[CANDIDATES] = round(float(chosen.float().mean()), 4)
        return figures, facts


KINDS: dict[str, type[Stage]] = {kind.NAME: kind for kind in (DepthStage, SketchStage, OccupancyStage)}


def stages_of(parts: Parts, data: OccupancyData) -> list[Stage]:
    """Return the stages of a configuration up to the wanted one, in order.

    Raises:
        UserError: for an unknown stage, or one that the model does not have.
    """
    stages: list[Stage] = []
    names = wanted_stages(parts.cfg)
    for name in names:
        stages.append(KINDS[name](parts, data, tuple(stages), has_reader=name != names[-1]))
    return stages


def score_of(data: OccupancyData) -> str | None:
    """Return the score by which the best checkpoint is chosen; None (the last one) without voxels and LiDAR."""
    scene = next(iter(data.source.scenes("val")), None)
    if scene is None or data.voxels.read(scene, 0) is not None:
        return "val/rayiou"
    return None if scene.lidar(0) is None else "val/lidar/rayiou"


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
    return (ranges.read(scene, frame),)


def predict_range_m(task: DepthTask, rig: Rig, images: Tensor, true_range_m: Tensor | None) -> tuple[Tensor]:
    """Return the predicted panorama of a frame, (h, w), m; nan where unknown."""
    return (task.model(images, (rig,), true_range_m).known_range_m()[0],)


def predict_sketched(task: SketchTask, rig: Rig, range_m: Tensor) -> tuple[Tensor, ...]:
    """Return candidates, and bits of the evidence if there is any, (X, Y, Z) each, from a predicted panorama."""
    return tuple(part[0] for part in task.sketch.propose(*finite_ranges(range_m)) if part is not None)


@contextmanager
def lock_folder(folder: Path, title: str) -> Iterator[None]:
    """Lock a stage's folder; wait while another process works in it."""
    try:
        lock = acquire(folder / ".lock")
    except Held:
        with show_waiting(title, f"waits for another process that works in {folder}"):
            lock = acquire(folder / ".lock", wait=True)
    try:
        yield
    finally:
        lock.release()
