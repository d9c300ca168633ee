"""Test a checkpoint again, or score predictions of any project as files in a benchmark's submission format.

python src/evaluate.py runs/demo-.../best.ckpt [key=value ...]
python src/evaluate.py predictions=folder data=occ3d_nuscenes data.source.root=...
"""

import argparse
from pathlib import Path
from typing import cast

import torch
from lightning.pytorch import Trainer

from omniocc.config import build, compose_config
from omniocc.data import Needs, OccupancyData
from omniocc.data.origins import ORIGINS, Origins
from omniocc.model.occupancy import to_unit_range
from omniocc.model.protocols import LearnedSketch, learns
from omniocc.progress import Progress
from omniocc.run.folder import IMAGES, git_commit
from omniocc.run.results import PROTOCOL, save_results, show_results
from omniocc.run.script import lines_not_tracebacks, quiet_libraries
from omniocc.run.weights import SHIPPED, find_checkpoint
from omniocc.task import OccupancyTask, StepProgress
from omniocc.task.audit import Audit
from omniocc.task.build import load_task
from omniocc.task.images import OccupancyImages
from omniocc.task.submission import score_files


@lines_not_tracebacks
def main(arguments: list[str] | None = None) -> None:
    """Rebuild the model from its file, score it on the test scenes, write the results beside the checkpoint."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("checkpoint", help="file written by train.py, a name of shipped weights, or predictions=folder")
    parser.add_argument("overrides", nargs="*", help="key=value, such as data.batch_size=1")
    parser.add_argument(
        "--output",
        type=Path,
        help="folder of results (default: evaluation-<checkpoint> beside it, and the origins if they are given)",
    )
    parser.add_argument("--images", type=int, default=4, help="test frames to draw")
    where = "where rays of RayIoU start: own (the dataset's protocol, else the ego origin: the default), ego, or "
    where += "trajectory (where the car was in past, present and future frames, scored apart as well)"
    parser.add_argument("--origins", choices=ORIGINS, default="own", help=where)
    parser.add_argument("--audit", action="store_true", help="only print where the score is lost, on validation scenes")
    options = parser.parse_intermixed_args(arguments)
    for override in options.overrides:
        if "=" not in override:
            parser.error(f"'{override}' is not key=value; one checkpoint at a time")
    quiet_libraries()
    if options.checkpoint.startswith("predictions="):
        folder = Path(options.checkpoint.partition("=")[2])
        score_predictions(folder, options.overrides, options.output, options.origins)
        return
    checkpoint = find_checkpoint(Path(options.checkpoint))
    task, data = load_task(checkpoint, options.overrides)
    data.cast_from(options.origins)
    if options.audit:
        data.prepare_data()
        print(f"{len(data.source.scenes('val'))} validation scenes of {data.source.folder}")
        for name, value in audit(task, data):
            print(f"{name:58} {value}")
        return
    beside = Path("runs") if checkpoint.parent == SHIPPED else checkpoint.parent
    folder = options.output or beside / f"evaluation-{checkpoint.stem}{suffix(options.origins)}"
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
    facts |= {PROTOCOL: task.scores.protocol()}
    save_results(folder, metrics, facts)
    show_results(folder)


def score_predictions(folder: Path, overrides: list[str], output: Path | None, origins: Origins) -> None:
    """Score the files in a folder on the test scenes of the data that the overrides choose; write table and figures."""
    data: OccupancyData = build(compose_config(Path(__file__).parents[1] / "conf", "train", overrides).data)
    source = data.source
    source.prepare()
    metrics, protocol = score_files(source, folder, origins=origins)
    output = output or folder.with_name(f"{folder.name}-scores{suffix(origins)}")
    facts = {"predictions": str(folder), "commit": git_commit(), "data": source.fingerprint, PROTOCOL: protocol}
    save_results(output, metrics, facts)
    show_results(output)


def suffix(origins: Origins) -> str:
    """Return the end of a default folder of results, so that those from other origins stand beside the others."""
    return "" if origins == "own" else f"-{origins}"


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
