"""Test a checkpoint again: `python src/evaluate.py runs/demo-.../best.ckpt [key=value ...]`."""

import argparse
from pathlib import Path
from typing import cast

import torch
from lightning.pytorch import Trainer

from omniocc.data import Needs, OccupancyData
from omniocc.model.occupancy import to_unit_range
from omniocc.model.protocols import LearnedSketch, learns
from omniocc.progress import Progress
from omniocc.run.folder import IMAGES, git_commit
from omniocc.run.results import save_results, show_results
from omniocc.run.script import lines_not_tracebacks, quiet_libraries
from omniocc.run.weights import SHIPPED, find_checkpoint
from omniocc.task import OccupancyTask, StepProgress
from omniocc.task.audit import Audit
from omniocc.task.build import load_task
from omniocc.task.images import OccupancyImages


@lines_not_tracebacks
def main(arguments: list[str] | None = None) -> None:
    """Rebuild the model from its file, score it on the test scenes, write the results beside the checkpoint."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("checkpoint", type=Path, help="file written by train.py, or a name of shipped weights")
    parser.add_argument("overrides", nargs="*", help="key=value, such as data.batch_size=1")
    parser.add_argument("--output", type=Path, help="folder of results (default: evaluation-<checkpoint> beside it)")
    parser.add_argument("--images", type=int, default=4, help="test frames to draw")
    parser.add_argument("--audit", action="store_true", help="only print where the score is lost, on validation scenes")
    options = parser.parse_intermixed_args(arguments)
    for override in options.overrides:
        if "=" not in override:
            parser.error(f"'{override}' is not key=value; one checkpoint at a time")
    quiet_libraries()
    checkpoint = find_checkpoint(options.checkpoint)
    task, data = load_task(checkpoint, options.overrides)
    if options.audit:
        print(f"{len(data.source.scenes('val'))} validation scenes of {data.source.folder}")
        for name, value in audit(task, data):
            print(f"{name:58} {value}")
        return
    beside = Path("runs") if checkpoint.parent == SHIPPED else checkpoint.parent
    folder = options.output or beside / f"evaluation-{checkpoint.stem}"
    folder.mkdir(parents=True, exist_ok=True)
    images = OccupancyImages(folder / IMAGES, options.images, data.source.spec.classes)
    trainer = Trainer(
        callbacks=[StepProgress("occupancy"), images],
        logger=False,
        enable_checkpointing=False,
        enable_model_summary=False,
        devices=1,
    )
    metrics = trainer.test(task, datamodule=data, verbose=False)[0]
    facts = {"checkpoint": str(checkpoint), "commit": git_commit(), "data": data.source.fingerprint}
    save_results(folder, metrics, facts)
    show_results(folder)


@torch.inference_mode()
def audit(task: OccupancyTask, data: OccupancyData) -> list[tuple[str, str]]:
    """Return what each part of a model costs, on validation scenes; see `omniocc.task.audit`."""
    needs = Needs(panorama=True)
    data.read_only(needs, needs)
    data.setup()
    loader, task = data.val_dataloader(), task.eval()
    found = Audit(task.model.geometry, data.source.spec)
    with Progress("audit", len(loader), "batches") as progress:
        for batch in loader:
            logits = task.predict(batch).logits
            images = to_unit_range(batch.images[:, -1])
            sketched = task.model.choose(images, batch.newest_rigs)
            found.update(logits, sketched, batch)
            if batch.erp_range_m is not None and learns(type(task.model.sketch)):
                sketch = cast(LearnedSketch, task.model.sketch)
                seen = sketch.depth(images, batch.newest_rigs, batch.erp_range_m)
                found.update_ranges(seen.range_m, batch, sketch.panorama)
            progress.advance()
    return found.lines()


if __name__ == "__main__":
    main()
