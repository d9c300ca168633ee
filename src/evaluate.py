"""Test a checkpoint again, find what breaks it, or score predictions of any project in a benchmark's format.

python src/evaluate.py runs/demo-.../best.ckpt [key=value ...]
python src/evaluate.py runs/*/best.ckpt --origins trajectory
python src/evaluate.py runs/ours-.../best.ckpt runs/bevdet-.../best.ckpt robustness=all
python src/evaluate.py tiny robustness=[camera_dropped,view_180_deg,extrinsics_deg]
python src/evaluate.py predictions=folder data=occ3d_nuscenes data.source.root=...

Robustness: the same test scenes are scored with something wrong, part by part; each finished part is kept, so that the
same command goes on after a stop. A word names one part (view_180_deg) or all of a kind (view):
"""

import argparse
import textwrap
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple, cast

import cv2
import numpy as np
import torch
from lightning.pytorch import Trainer

from omniocc.config import build, compose_config
from omniocc.data import Needs, OccupancyData
from omniocc.data.origins import ORIGINS, Origins
from omniocc.errors import UserError, installing
from omniocc.io import atomic_write
from omniocc.model.protocols import LearnedSketch, learns, takes_true_range
from omniocc.progress import Progress
from omniocc.report.tables.robustness import robustness_markdown, robustness_text
from omniocc.run.folder import IMAGES, git_commit
from omniocc.run.results import EVALUATION, OVERRIDES, PROTOCOL, save_results, show_results
from omniocc.run.robustness import FOLDER, Robustness, save_robustness
from omniocc.run.script import lines_not_tracebacks, quiet_libraries
from omniocc.run.wandb import Loggers
from omniocc.run.wandb.robustness import log_robustness
from omniocc.run.weights import SHIPPED, find_checkpoint
from omniocc.task import OccupancyTask, StepProgress
from omniocc.task.audit import Audit
from omniocc.task.build import load_task
from omniocc.task.images import OccupancyImages
from omniocc.task.robustness.evaluation import robustness_of, system_of
from omniocc.task.robustness.parts import UNSEEN, parts_of
from omniocc.task.scene_counts import save_by_scene
from omniocc.task.submission import score_files

CONF = Path(__file__).parents[1] / "conf"


class Words(NamedTuple):
    """The words of the command line that are no options.

    Attributes:
        checkpoints: files, those of shipped names included.
        overrides: of the configuration of the checkpoints.
        predictions: folder of files to be scored; None: checkpoints are tested.
        robustness: `all`, or names of parts; None: no robustness test.
    """

    checkpoints: Sequence[Path]
    overrides: Sequence[str]
    predictions: Path | None = None
    robustness: list[str] | None = None

    @classmethod
    def of(cls, words: Sequence[str]) -> "Words":
        """Return the words by their meaning; what is a file or has no `=` is a checkpoint."""
        files = [word for word in words if "=" not in word or Path(word).is_file()]
        settings = {key: value for key, _, value in (word.partition("=") for word in words if word not in files)}
        predictions, robustness = settings.pop("predictions", None), settings.pop("robustness", None)
        return cls(
            [find_checkpoint(Path(file)) for file in files],
            [f"{key}={value}" for key, value in settings.items()],
            None if predictions is None else Path(predictions),
            None if robustness is None else robustness.strip("[]").replace(" ", "").split(","),
        )


def parser_of() -> argparse.ArgumentParser:
    """Return the parser of the command line, whose help lists the kinds of disturbances."""
    kinds = ", ".join(dict.fromkeys(part.group for part in parts_of(("front", "left", "rear"), (UNSEEN,))[1:]))
    about = "\n".join([__doc__ or "", *textwrap.wrap(kinds, 110)])
    parser = argparse.ArgumentParser(description=about, formatter_class=argparse.RawDescriptionHelpFormatter)
    what = "file written by train.py, name of shipped weights, predictions=folder, robustness=..., or key=value"
    parser.add_argument("words", nargs="+", metavar="word", help=f"{what} such as data.batch_size=1")
    where = "folder of results (default: evaluation-<checkpoint>, or robustness-<checkpoint>, beside it)"
    parser.add_argument("--output", type=Path, help=where)
    rays = "where rays of RayIoU start: own (the dataset's protocol, else the ego origin: the default), ego, or "
    rays += "trajectory (where the car was in past, present and future frames, scored apart as well)"
    parser.add_argument("--origins", choices=ORIGINS, default="own", help=rays)
    parser.add_argument("--images", type=int, default=4, help="test frames to draw (default: 4)")
    parser.add_argument("--audit", action="store_true", help="only print where the score is lost, on validation scenes")
    parser.add_argument("--scenes", type=int, default=8, help="robustness: test scenes, the first ones (default: 8)")
    parser.add_argument("--seed", type=int, default=0, help="robustness: of what is drawn at random (default: 0)")
    return parser


@lines_not_tracebacks
def main(arguments: list[str] | None = None) -> None:
    """Rebuild the model from its file, score it on the test scenes, write the results beside the checkpoint."""
    parser = parser_of()
    options = parser.parse_intermixed_args(arguments)
    words = Words.of(options.words)
    if words.predictions is not None and (words.checkpoints or words.robustness is not None or options.audit):
        parser.error("predictions=... scores files alone: leave checkpoints, robustness=... and --audit out")
    if words.robustness is not None and (options.audit or options.origins != "own"):
        parser.error("robustness=... is a test of its own: leave --audit and --origins out")
    quiet_libraries()
    if words.predictions is not None:
        score_predictions(words.predictions, words.overrides, options.output, options.origins)
        return
    if not words.checkpoints:
        raise UserError("name a checkpoint, a shipped file of weights, or predictions=folder")
    if words.robustness is not None:
        score_robustness(words.checkpoints, words.overrides, words.robustness, options)
        return
    several, refused = len(words.checkpoints) > 1, []
    for checkpoint in words.checkpoints:
        if several:
            print(f"\nsystem    {system_of(checkpoint)}", flush=True)
        try:
            if options.audit:
                print_audit(checkpoint, words.overrides)
            else:
                name = f"{EVALUATION}{checkpoint.stem}{suffix(options.origins)}"
                folder = folder_of(checkpoint, name, options.output, several)
                test_again(checkpoint, words.overrides, folder, options.origins, options.images)
        except (UserError, OSError) as error:  # the others come first
            refused.append(str(error))
    raise_all(refused)


def raise_all(refused: Sequence[str]) -> None:
    """Raise UserError with all different messages; nothing without one."""
    if refused:
        raise UserError("\n".join(dict.fromkeys(refused)))


def refuse_true_range(checkpoint: Path, task: OccupancyTask) -> None:
    """Raise UserError for a checkpoint whose candidates are chosen by recorded ranges."""
    if takes_true_range(task.model.sketch):
        raise UserError(
            f"{checkpoint} takes recorded ranges (model/depth=truth), which only train.py hands to it: its test is in "
            "table.md of its folder"
        )


def print_audit(checkpoint: Path, overrides: Sequence[str]) -> None:
    """Print what each part of a checkpoint costs on validation scenes."""
    task, data = load_task(checkpoint, overrides)
    refuse_true_range(checkpoint, task)
    data.prepare_data()
    scenes = data.source.scenes("val")
    if not scenes or data.voxels.read(scenes[0], 0) is None:
        raise UserError(f"{data.source.folder} has no true voxels of validation scenes, with which an audit compares")
    print(f"{len(scenes)} validation scenes of {data.source.folder}")
    for name, value in audit(task, data):
        print(f"{name:58} {value}")


def test_again(checkpoint: Path, overrides: Sequence[str], folder: Path, origins: Origins, drawn: int) -> None:
    """Score a checkpoint on the test scenes, with rays from these origins; write figures, table and `drawn` images.

    Raises:
        UserError: when the checkpoint takes recorded ranges, which only the training command hands to it.
    """
    task, data = load_task(checkpoint, overrides)
    refuse_true_range(checkpoint, task)
    data.cast_from(origins)
    folder.mkdir(parents=True, exist_ok=True)
    images = OccupancyImages(folder / IMAGES, drawn, data.spec.classes)
    trainer = Trainer(
        callbacks=[StepProgress("occupancy"), images],
        logger=False,
        enable_checkpointing=False,
        enable_model_summary=False,
        devices=1,
    )
    metrics = trainer.test(task, datamodule=data, verbose=False)[0]
    facts = {"checkpoint": str(checkpoint), "commit": git_commit(), "data": data.source.fingerprint}
    facts |= {OVERRIDES: list(overrides), PROTOCOL: task.protocol}
    save_by_scene(folder, task.scores, data.source, task.by_scene.of_all())
    save_results(folder, metrics, facts)
    show_results(folder)


def score_robustness(
    checkpoints: Sequence[Path], overrides: Sequence[str], wanted: Sequence[str], options: argparse.Namespace
) -> None:
    """Score checkpoints under disturbances, one after the other; write and log the results, print the comparison."""
    logging = [word for word in overrides if word.startswith("logger.")]
    others = [word for word in overrides if word not in logging]
    logger: Loggers = build(compose_config(CONF, "train", logging).logger)
    records, refused = [], []
    for checkpoint in checkpoints:
        folder = folder_of(checkpoint, f"{FOLDER}{checkpoint.stem}", options.output, True)
        try:
            task, data = load_task(checkpoint, others)
            record = robustness_of(task, data, checkpoint, wanted, options.scenes, options.seed, folder)
        except (UserError, OSError) as error:  # the others come first
            refused.append(str(error))
            continue
        save_robustness(folder, record)
        atomic_write(folder / "table.md", robustness_markdown([record]))
        log_robustness(logger.build(folder, task.config, "robustness"), record, draw([record], folder))
        records.append(record)
        print(f"table     {folder / 'table.md'}", flush=True)
    if records:
        print(f"\n{robustness_text(records)}\n\nall systems: python src/report.py")
    raise_all(refused)


def draw(records: Sequence[Robustness], folder: Path) -> np.ndarray | None:
    """Write the plot of a test, and return it as an RGB image; None without matplotlib."""
    if find_spec("matplotlib") is None:
        print(f"No plot: matplotlib is missing: {installing('plot')}")
        return None
    from omniocc.report.plots.robustness import drops
    from omniocc.report.plots.svg import as_png

    path = folder / "robustness.png"
    atomic_write(path, png := as_png(drops(records)))
    return cv2.cvtColor(np.asarray(cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)), cv2.COLOR_BGR2RGB)


def folder_of(checkpoint: Path, name: str, output: Path | None, by_system: bool) -> Path:
    """Return the folder of results: `name` beside the checkpoint, or in `output`, where systems may have their own."""
    if output is not None:
        return output / system_of(checkpoint) / name if by_system else output
    return (Path("runs") if checkpoint.parent == SHIPPED else checkpoint.parent) / name


def score_predictions(folder: Path, overrides: Sequence[str], output: Path | None, origins: Origins) -> None:
    """Score the files in a folder on the test scenes of the data that the overrides choose; write table and figures."""
    data: OccupancyData = build(compose_config(CONF, "train", overrides).data)
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
    found = Audit(task.model.geometry, data.spec)
    with Progress("audit", len(loader), "batches") as progress:
        for batch in loader:
            logits = task.predict(batch).logits
            images = batch.images[:, -1]
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
