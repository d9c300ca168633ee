"""Train the stages of a configuration that are missing, test the best checkpoint, write figures and images."""

from collections.abc import Sequence
from pathlib import Path
from time import time
from typing import Any

from lightning.pytorch import Trainer, seed_everything
from lightning.pytorch.callbacks import Callback, ModelCheckpoint
from omegaconf import DictConfig, OmegaConf

from omniocc.camera import Rig
from omniocc.classes import FREE, ClassTable
from omniocc.config import build, check_root, plain, target_of
from omniocc.data import Needs, OccupancyData, SourceSpec
from omniocc.io import atomic_write
from omniocc.model.protocols import learns
from omniocc.run.checkpoint_io import BEST, LAST, AtomicCheckpointIO
from omniocc.run.cost import PEAK, cost_of, peak_mib
from omniocc.run.distributed import is_first
from omniocc.run.folder import IMAGES, RunFolder, command_line, git_commit, given_checkpoint, open_run, run_hash
from omniocc.run.machine import MACHINE, machine
from omniocc.run.memory import keep_freed_memory
from omniocc.run.plan import hours_line, plan_line, planned_steps, validation_times
from omniocc.run.results import (
    CANDIDATES,
    EARLIER_MINUTES,
    FINISHED,
    MINUTES,
    PROTOCOL,
    load_results,
    made_by_other_code,
    save_results,
    show_results,
    utc_text,
)
from omniocc.run.slots import sketch_learns, slots_line
from omniocc.run.wandb.loggers import finish, log_earlier_stages
from omniocc.task import OccupancyTask, StepProgress, TrainingTime
from omniocc.task.build import bare_trainer, build_task, check_devices, line_on_lifter, switch_off_head
from omniocc.task.images import OccupancyImages
from omniocc.task.last import LastCheckpoint
from omniocc.task.scene_counts import save_by_scene
from omniocc.task.stage_keys import wanted_stages
from omniocc.task.stages import Stages
from omniocc.task.start import check_resumed, check_weights, load_fitting
from omniocc.task.step_time import planned_scenes, rehearse, step_seconds
from omniocc.task.stop import StopAtSignal


def train(cfg: DictConfig) -> None:
    """Check the configuration of `conf/train.yaml`, build, and run the missing stages, occupancy last.

    Raises:
        UserError, ConfigError: naming the key, file or part that cannot be used, before anything is trained.
    """
    check_root(cfg)
    keep_freed_memory()
    check_devices(cfg.trainer)
    stages = wanted_stages(cfg)
    data: OccupancyData = build(cfg.data)
    data.check_classes()
    if "occupancy" in stages:
        # mistakes in the last stage are reported before the earlier stages are trained
        given_checkpoint(cfg.resume)
        if cfg.weights is not None:
            check_weights(cfg.weights, cfg.resume)
        build_task(cfg, data.spec)
    if cfg.plan:
        rig, frames = planned_scenes(data.source)
        print(f"{'model':10}{slots_line(plain(cfg))}")
        announce_plan(cfg, stages, frames, (rig, data.spec))
        return
    data.prepare_data()
    without_head = switch_off_head(cfg, data.source.scenes("train"))
    frames = sum(map(len, data.source.scenes("train")))
    if "occupancy" in stages and (given := given_checkpoint(cfg.resume)) is not None:
        check_resumed(
            given, plain(cfg), planned_steps(*training_amount(cfg, "occupancy", frames, bare_trainer(cfg.trainer)))
        )
    earlier = Stages(cfg, data) if sketch_learns(cfg) else None
    if is_first():
        for line in filter(None, (without_head, line_on_lifter(cfg.model.lifter, data.geometry), *data.remarks())):
            print(line, flush=True)
        announce_plan(cfg, stages, frames)
    if earlier is not None and not earlier.finished:
        device = bare_trainer(cfg.trainer).strategy.root_device
        rehearse(cfg, stages, data.source.scenes("train")[0].rigs[0], data.spec, device)
    figures: dict[str, float] = {}
    for number, stage in enumerate(stages, start=1):
        title = f"{stage}, stage {number} of {len(stages)}"
        if stage == "occupancy":
            train_occupancy(cfg, data, earlier, figures, title)
        elif earlier is not None:
            figures |= earlier.run(stage, title)
            if is_first():
                show_results(earlier.results[stage])


def train_occupancy(
    cfg: DictConfig, data: OccupancyData, earlier: Stages | None, figures: dict[str, float], title: str
) -> None:
    """Train, test, and write figures and images, together with the figures of the earlier stages."""
    seed_everything(cfg.seed, workers=True, verbose=False)
    config = plain(cfg)
    run = open_run(Path(cfg.paths.runs), cfg.name, run_hash(config, data.source.fingerprint), cfg.resume)
    if run.finished:
        print(f"{run.path} is finished{made_by_other_code(run.path)}; resume=never trains again beside it")
        show_results(run.path)
        return
    if run.lock is not None:
        atomic_write(run.path / "config.yaml", OmegaConf.to_yaml(cfg, resolve=True))
    task = build_task(cfg, data.spec)
    if earlier is not None:
        task.model.sketch.load_state_dict(earlier.sketch_weights())  # type: ignore[union-attr]
    evidence = earlier and earlier.evidence
    test = Needs(pixel_labels=False, candidates=earlier and earlier.candidates, evidence=evidence)
    learned = {"pixel_labels": len(task.loss.pixel) > 0, "camera_ranges": len(task.loss.ray) > 0}
    data.read_only(test._replace(scores=False, **learned), test)
    data.setup("fit")
    task.set_training_statistics(data.voxel_counts())
    begun_with = None
    if cfg.weights is not None and run.checkpoint is None:
        begun_with = load_fitting(task.model, cfg.weights, config)
    files = build(cfg.logger).build(run.path, config, "occupancy")
    trainer = build(
        cfg.trainer,
        **validation_times(cfg.trainer),
        callbacks=[
            duration := TrainingTime(),
            *map(build, cfg.callbacks.values()),
            *callbacks(cfg, run, title, data.spec.classes, score_of(data)),
        ],
        plugins=[AtomicCheckpointIO()],
        logger=files,
        default_root_dir=str(run.path),
    )
    if trainer.is_global_zero:
        announce(run, task, data, begun_with)
    trainer.fit(task, datamodule=data, ckpt_path=run.checkpoint and str(run.checkpoint))
    minutes = duration.minutes  # the best checkpoint, which is tested, has its own
    trainer.save_checkpoint(run.path / LAST)
    tested = run.path / (BEST if (run.path / BEST).exists() else LAST)
    metrics = trainer.validate(task, datamodule=data, ckpt_path=str(tested), verbose=False)[0]
    metrics |= trainer.test(task, datamodule=data, ckpt_path=str(tested), verbose=False)[0]
    by_scene = task.by_scene.of_all()
    if trainer.is_global_zero:
        log_earlier_stages(trainer.loggers, figures, trainer.global_step)
        facts = {"run": run.path.name, "checkpoint": tested.name, "seed": cfg.seed, "steps": trainer.global_step}
        facts |= {"preset": cfg.preset.name, "command": command_line()}
        device = trainer.strategy.root_device
        facts |= {MINUTES: minutes, PEAK: peak_mib(device), MACHINE: machine(device)}
        facts |= cost_of(task.model.eval(), data.dataset("test")[0])
        facts |= facts_of_report(task, data, earlier, trainer.global_step)
        facts |= {"commit": git_commit(), "data": data.source.fingerprint, PROTOCOL: task.protocol}
        facts |= {FINISHED: utc_text(time())}
        save_by_scene(run.path, task.scores, data.source, by_scene)
        save_results(run.path, metrics | figures, facts)
        finish(trainer.loggers)
        show_results(run.path)


def facts_of_report(task: OccupancyTask, data: OccupancyData, earlier: Stages | None, steps: int) -> dict[str, Any]:
    """Return facts for the report: steps of every stage, names and colours of the classes, fraction of candidates.

    The fraction is measured here only if the sketch is not learned; else the test of its stage measures it.
    """
    before = {} if earlier is None else {name: load_results(path)[0] for name, path in earlier.results.items()}
    stages = {name: facts["steps"] for name, facts in before.items()}
    rows = data.spec.classes.rows
    classes = [{"name": row.name, "rgb": row.rgb} for row in rows if row.id != FREE]
    facts = {"stages": {**stages, "occupancy": steps}, "classes": classes}
    facts[EARLIER_MINUTES] = round(sum(known.get(MINUTES, 0.0) for known in before.values()), 1)
    if earlier is not None:
        return facts
    sample = data.dataset("test")[0]
    candidates = task.model.choose(sample.images[-1:].to(task.device), sample.rigs[-1:]).candidates
    return facts | {CANDIDATES: round(float(candidates.float().mean()), 4)}


def score_of(data: OccupancyData) -> str | None:
    """Return the score by which the best checkpoint is chosen; None (the last one) without voxels and LiDAR."""
    scene = next(iter(data.source.scenes("val")), None)
    if scene is None or data.voxels.read(scene, 0) is not None:
        return "val/rayiou"
    return None if scene.lidar(0) is None else "val/lidar/rayiou"


def callbacks(cfg: DictConfig, run: RunFolder, title: str, classes: ClassTable, score: str | None) -> list[Callback]:
    """Return callbacks for progress, the last and the best checkpoint by a score, and images."""
    steps = cfg.checkpoint_every_n_steps
    return [
        StepProgress(title),
        ModelCheckpoint(run.path, "best", monitor=score, mode="max", enable_version_counter=False),
        LastCheckpoint(run.path / LAST, steps),
        StopAtSignal(run.path / LAST),
        OccupancyImages(run.path / IMAGES, cfg.test_images, classes),
    ]


def announce_plan(
    cfg: DictConfig, stages: Sequence[str], frames: int, hours: tuple[Rig, SourceSpec] | None = None
) -> None:
    """Print how many steps, samples and epochs each stage takes; those that are finished are included.

    `hours` are the source's rig and classes, with which the duration is measured as well.
    """
    trainer = bare_trainer(cfg.trainer)
    if hours is not None:
        print(
            "some steps of every stage are timed: seconds at preset=tiny, minutes for large sizes on a CPU", flush=True
        )
    for stage in stages:
        if stage == "depth" and not learns(target_of(cfg.depth)):
            print(f"{stage:10}nothing to train", flush=True)
            continue
        amount = training_amount(cfg, stage, frames, trainer)
        print(f"{stage:10}{plan_line(*amount)}", flush=True)
        if hours is not None:
            step_s = trainer.accumulate_grad_batches * step_seconds(cfg, stage, *hours, trainer.strategy.root_device)
            print(f"{'':10}{hours_line(planned_steps(*amount), step_s)}", flush=True)


def training_amount(
    cfg: DictConfig, stage: str, frames: int, trainer: Trainer
) -> tuple[int, int | None, int, int, int, int]:
    """Return the arguments of `planned_steps` for a stage that is trained on this many frames."""
    length = cfg.trainer if stage == "occupancy" else cfg.stages[stage]
    size = cfg.data.batch_size if stage == "occupancy" else length.batch_size
    devices = trainer.num_devices * trainer.num_nodes
    return length.max_steps, length.max_epochs, frames, size, devices, trainer.accumulate_grad_batches


def announce(run: RunFolder, task: OccupancyTask, data: OccupancyData, weights: str | None) -> None:
    """Print a line each on run, model, the weights that it starts from (None: random ones), and data."""
    parameters = sum(p.numel() for p in task.model.parameters()) / 1e6
    print(f"run       {run.path}" + (f", goes on from {run.checkpoint.name}" if run.checkpoint else ""))
    grid = task.model.geometry
    print(f"model     {parameters:.2f} M parameters, {type(grid).__name__} {'x'.join(map(str, grid.shape))}")
    if weights is not None:
        print(f"weights   {weights}")
    print(f"data      {data.source.folder}", flush=True)
