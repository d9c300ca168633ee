"""Score checkpoints, or files of predictions, on test scenes: the work of `src/evaluate.py`."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lightning.pytorch import Trainer

from omniocc.classes import OCCUPANCY_CLASSES, ONE_CLASS
from omniocc.config import check_root
from omniocc.data.origins import Origins
from omniocc.errors import UserError
from omniocc.model.protocols import takes_true_range
from omniocc.parts import Parts
from omniocc.predict.trained import Trained, load
from omniocc.runs.folder import git_commit
from omniocc.runs.results import EVALUATION, IMAGES, OVERRIDES, PROTOCOL, save_results, show_results
from omniocc.runs.script import read_overrides, train_config
from omniocc.runs.weights import SHIPPED, find_checkpoint
from omniocc.train import StepProgress
from omniocc.train.audit import audit
from omniocc.train.data_module import DataModule
from omniocc.train.images import OccupancyImages
from omniocc.train.scene_counts import save_by_scene
from omniocc.train.submission import score_files


@dataclass(frozen=True)
class Evaluation:
    """Choice of what is scored and how; see `python src/evaluate.py --help`.

    Attributes:
        checkpoints: files of checkpoints or of shipped weights.
        overrides: `key=value` changes to the configuration of the checkpoints.
        predictions: folder of prediction files to be scored; None: the checkpoints are scored.
        robustness: `all`, or names of parts of the robustness test; None: no robustness test.
        output: folder of results; None: beside the checkpoint or the predictions.
        origins: where the rays of RayIoU start.
        images: number of test frames to draw.
        audit: whether to print only where the score is lost.
        scenes: number of test scenes of the robustness test.
        seed: random seed of the robustness test.
    """

    checkpoints: Sequence[Path]
    overrides: Sequence[str]
    predictions: Path | None
    robustness: Sequence[str] | None
    output: Path | None = None
    origins: Origins = "own"
    images: int = 4
    audit: bool = False
    scenes: int = 8
    seed: int = 0

    @classmethod
    def from_words(cls, words: Sequence[str], **options: Any) -> "Evaluation":
        """Parse the words of the command line: files and words without `=` are checkpoints, others settings."""
        # the path of a checkpoint may hold '=': epoch=1-step=2.ckpt
        files = [word for word in words if "=" not in word or Path(word).is_file()]
        settings = {key: value for key, _, value in (word.partition("=") for word in words if word not in files)}
        predictions, robustness = settings.pop("predictions", None), settings.pop("robustness", None)
        return cls(
            [find_checkpoint(file) for file in files],
            [f"{key}={value}" for key, value in settings.items()],
            None if predictions is None else Path(predictions),
            None if robustness is None else robustness.strip("[]").replace(" ", "").split(","),
            **options,
        )

    @property
    def conflict(self) -> str | None:
        """Return an error message if options contradict each other, None otherwise."""
        if self.predictions is not None and (self.checkpoints or self.robustness is not None or self.audit):
            return "predictions=... scores files alone: leave checkpoints, robustness=... and --audit out"
        if self.robustness is not None and (self.audit or self.origins != "own"):
            return "robustness=... is a test of its own: leave --audit and --origins out"
        return None

    @property
    def suffix(self) -> str:
        """Return the end of the default folder name, so that results from other origins do not replace the own ones."""
        return "" if self.origins == "own" else f"-{self.origins}"

    def run(self) -> None:
        """Score the predictions or every checkpoint; errors of single checkpoints are raised after the last one.

        Raises:
            UserError, DataError: with the checkpoints or files that cannot be scored.
        """
        if self.predictions is not None:
            return score_predictions(self)
        if not self.checkpoints:
            raise UserError("name a checkpoint, a shipped file of weights, or predictions=folder")
        return score_each(self.checkpoints, self._score)

    def _score(self, checkpoint: Path) -> None:
        several = len(self.checkpoints) > 1
        if several:
            print(f"\nsystem    {system_name(checkpoint)}", flush=True)
        trained = load_with_overrides(checkpoint, self.overrides)
        if takes_true_range(trained.occupancy.sketch):
            raise UserError(
                f"{checkpoint} takes recorded ranges (model/depth=truth), which only train.py hands to it: its test is "
                "in table.md of its folder"
            )
        if self.audit:
            for name, value in audit(trained.task, trained.data):
                print(f"{name:58} {value}")
        else:
            folder = results_folder(checkpoint, f"{EVALUATION}{checkpoint.stem}{self.suffix}", self.output, several)
            score_checkpoint(trained, folder, self)


def load_with_overrides(checkpoint: Path, overrides: Sequence[str]) -> Trained:
    """Load a checkpoint with overrides; `packages=[...]` among them allows classes of other packages."""
    packages = [word for word in overrides if word.startswith("packages=")]
    changes = [word for word in overrides if word not in packages]
    return load(checkpoint, changes, read_overrides(packages).get("packages", ()))


def score_each(checkpoints: Iterable[Path], score: Callable[[Path], None]) -> None:
    """Score the checkpoints in turn; raise one UserError at the end with the messages of all that failed."""
    messages = []
    for checkpoint in checkpoints:
        try:
            score(checkpoint)
        except (UserError, OSError) as error:  # the other checkpoints are scored first
            messages.append(str(error))
    if messages:
        raise UserError("\n".join(dict.fromkeys(messages)))  # each different message once


def score_checkpoint(trained: Trained, folder: Path, options: Evaluation) -> None:
    """Score a checkpoint on the test scenes; write metrics, table and images to the folder."""
    task, data = trained.task, trained.data
    data.restrict_to("test")
    data.set_ray_origins(options.origins)
    if data.num_classes == OCCUPANCY_CLASSES.num_classes:
        print(f"classes   {ONE_CLASS}", flush=True)
    print(f"tests     {trained.path} on the test scenes of {data.source.folder}", flush=True)
    folder.mkdir(parents=True, exist_ok=True)
    images = OccupancyImages(folder / IMAGES, options.images, data.spec.classes)
    trainer = Trainer(
        precision=trained.precision,  # type: ignore[arg-type]  # the one of the test after training
        callbacks=[StepProgress("occupancy"), images],
        logger=False,
        enable_checkpointing=False,
        enable_model_summary=False,
        devices=1,
    )
    metrics = trainer.test(task, datamodule=DataModule(data), verbose=False)[0]
    facts = {"checkpoint": str(trained.path), "commit": git_commit(), "data": data.source.fingerprint}
    facts |= {OVERRIDES: list(options.overrides), PROTOCOL: task.protocol}
    save_by_scene(folder, task.scores, data.source, task.counted)
    save_results(folder, metrics, facts)
    show_results(folder)


def results_folder(checkpoint: Path, name: str, output: Path | None, by_system: bool) -> Path:
    """Return the folder of results: `output`, or without one the folder `name` beside the checkpoint.

    With `by_system`, each system has a folder of its own in `output`. Results of shipped weights are in `runs`.
    """
    if output is not None:
        return output / system_name(checkpoint) / name if by_system else output
    return (Path("runs") if checkpoint.parent == SHIPPED else checkpoint.parent) / name


def score_predictions(options: Evaluation) -> None:
    """Score prediction files on the test scenes of the data in the overrides; write metrics and table."""
    folder = options.predictions
    assert folder is not None
    check_root(cfg := train_config(options.overrides))
    source = Parts(cfg).data().source
    source.prepare()
    metrics, protocol = score_files(source, folder, origins=options.origins)
    output = options.output or folder.with_name(f"{folder.name}-scores{options.suffix}")
    facts = {"predictions": str(folder), "commit": git_commit(), "data": source.fingerprint, PROTOCOL: protocol}
    save_results(output, metrics, facts)
    show_results(output)


def system_name(checkpoint: Path) -> str:
    """Return the name of the shipped weights, or of the folder of the run."""
    return checkpoint.stem if checkpoint.parent == SHIPPED else checkpoint.absolute().parent.name
