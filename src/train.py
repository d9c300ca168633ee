"""Train a model, test its best checkpoint on unseen scenes, write figures and pictures.

`--help` lists what can be chosen.
"""

import time
from pathlib import Path
from typing import Any

from lightning.pytorch import Trainer, seed_everything
from lightning.pytorch.callbacks import Callback, ModelCheckpoint
from omegaconf import DictConfig, OmegaConf

from omniocc.classes import FREE, WORLD_CLASSES
from omniocc.config import build, check_root, plain, script
from omniocc.data import Extras, OccupancyData
from omniocc.io import atomic_write
from omniocc.model.occupancy import to_unit_range
from omniocc.run.checkpoint_io import BEST, LAST, AtomicCheckpointIO
from omniocc.run.cost import PEAK, cost_of, peak_mib
from omniocc.run.folder import (
    PICTURES,
    RunFolder,
    command_line,
    git_commit,
    given_checkpoint,
    open_run,
    run_hash,
)
from omniocc.run.memory import keep_freed_memory
from omniocc.run.quiet import quiet
from omniocc.run.results import CANDIDATES, load_results, save_results, show_results
from omniocc.run.wandb.loggers import finish
from omniocc.task import Occupancy, StepProgress
from omniocc.task.checkpoint import build_task
from omniocc.task.pictures import Pictures
from omniocc.task.stages import Stages, is_learned, wanted_stages


@script("train")
def main(cfg: DictConfig) -> None:
    """Check -> build -> the stages that are missing, occupancy last."""
    check_root(cfg)
    quiet()
    keep_freed_memory()
    stages = wanted_stages(cfg)
    if "occupancy" in stages:
        # mistakes of the last stage are said now, not when the stages before have been trained
        given_checkpoint(cfg.resume)
        build_task(cfg)
    data = build(cfg.data)
    data.prepare_data()
    before = Stages(cfg, data) if is_learned(cfg) else None
    figures: dict[str, float] = {}
    for number, stage in enumerate(stages, start=1):
        title = f"{stage}, stage {number} of {len(stages)}"
        if stage == "occupancy":
            train_occupancy(cfg, data, before, figures, title)
        elif before is not None:
            figures |= before.run(stage, title)
            show_results(before.results[stage])


def train_occupancy(
    cfg: DictConfig, data: OccupancyData, before: Stages | None, figures: dict[str, float], title: str
) -> None:
    """Fit -> test -> figures and pictures, those of the stages before beside them."""
    seed_everything(cfg.seed, workers=True, verbose=False)
    config = plain(cfg)
    run = open_run(Path(cfg.paths.runs), cfg.name, run_hash(config, data.world.fingerprint), cfg.resume)
    if run.finished:
        print(f"{run.path} is finished; resume=never trains anew beside it")
        show_results(run.path)
        return
    if run.lock is not None:
        atomic_write(run.path / "config.yaml", OmegaConf.to_yaml(cfg, resolve=True))
    task = build_task(cfg)
    if before is not None:
        task.model.sketch.load_state_dict(before.sketch_weights())  # type: ignore[union-attr]
    data.read_also(Extras(true_ranges=len(task.loss.ray) > 0, candidates=before and before.candidates))
    data.setup("fit")
    task.set_training_statistics(data.voxel_counts())
    files = build(cfg.logger).build(run.path, config, "occupancy")
    trainer = build(
        cfg.trainer,
        callbacks=callbacks(cfg, run, title),
        plugins=[AtomicCheckpointIO()],
        logger=files,
        default_root_dir=str(run.path),
    )
    if trainer.is_global_zero:
        announce(run, task, data)
    minutes = fit(trainer, task, data, run)
    tested = run.path / (BEST if (run.path / BEST).exists() else LAST)
    metrics = trainer.test(task, datamodule=data, ckpt_path=str(tested), verbose=False)[0]
    if trainer.is_global_zero:
        for logger in trainer.loggers:
            logger.log_metrics(figures, trainer.global_step)
        facts = {"run": run.path.name, "checkpoint": tested.name, "seed": cfg.seed, "steps": trainer.global_step}
        facts |= {"preset": cfg.preset.name, "command": command_line()}
        facts |= {"minutes of training": minutes, PEAK: peak_mib(trainer.strategy.root_device)}
        facts |= cost_of(task.model.eval(), data.dataset("test")[0])
        facts |= facts_of_report(task, data, before, trainer.global_step)
        facts |= {"commit": git_commit(), "data": data.world.fingerprint}
        save_results(run.path, metrics | figures, facts)
        finish(trainer.loggers)
        show_results(run.path)


def facts_of_report(task: Occupancy, data: OccupancyData, before: Stages | None, steps: int) -> dict[str, Any]:
    """Return what the report needs besides figures.

    These are the steps of every stage, names and colours of the classes, and, of a sketch that is not a stage (whose
    test would have measured it), the fraction of voxels that are candidates.
    """
    stages = {} if before is None else {name: load_results(path)[0]["steps"] for name, path in before.results.items()}
    classes = [{"name": entry.name, "rgb": entry.rgb} for entry in WORLD_CLASSES.rows if entry.id != FREE]
    facts = {"stages": {**stages, "occupancy": steps}, "classes": classes}
    if before is not None:
        return facts
    sample = data.dataset("test")[0]
    candidates = task.model.choose(to_unit_range(sample.images[-1:].to(task.device)), (sample.rig,))
    return facts | {CANDIDATES: round(float(candidates.float().mean()), 4)}


def fit(trainer: Trainer, task: Occupancy, data: OccupancyData, run: RunFolder) -> float:
    """Train to the end; minutes it took this process."""
    began_s = time.monotonic()
    trainer.fit(task, datamodule=data, ckpt_path=run.checkpoint and str(run.checkpoint))
    trainer.save_checkpoint(run.path / LAST)
    return round((time.monotonic() - began_s) / 60, 1)


def callbacks(cfg: DictConfig, run: RunFolder, title: str) -> list[Callback]:
    """Progress, the last and the best checkpoint, pictures."""
    return [
        StepProgress(title),
        ModelCheckpoint(
            run.path, "last", every_n_train_steps=cfg.checkpoint_every_n_steps, enable_version_counter=False
        ),
        ModelCheckpoint(run.path, "best", monitor="val/rayiou", mode="max", enable_version_counter=False),
        Pictures(run.path / PICTURES, cfg.pictures),
    ]


def announce(run: RunFolder, task: Occupancy, data: OccupancyData) -> None:
    """One line each: what is trained, on what, where."""
    parameters = sum(p.numel() for p in task.model.parameters()) / 1e6
    print(f"run       {run.path}" + (f", goes on from {run.checkpoint.name}" if run.checkpoint else ""))
    grid = task.model.geometry
    print(f"model     {parameters:.2f} M parameters, {type(grid).__name__} {'x'.join(map(str, grid.shape))}")
    print(f"data      {data.world.folder}", flush=True)


if __name__ == "__main__":
    main()
