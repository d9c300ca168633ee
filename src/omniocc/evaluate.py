"""Score checkpoints or the predictions of others again: what `src/evaluate.py` does with its words."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lightning.pytorch import Trainer
from omegaconf import OmegaConf

from omniocc.config import compose_config
from omniocc.data.origins import Origins
from omniocc.errors import UserError
from omniocc.model.protocols import takes_true_range
from omniocc.parts import Parts
from omniocc.predict.trained import Trained, load
from omniocc.runs.folder import IMAGES, git_commit
from omniocc.runs.results import EVALUATION, OVERRIDES, PROTOCOL, save_results, show_results
from omniocc.runs.trust import CONF
from omniocc.runs.weights import SHIPPED, find_checkpoint
from omniocc.train import StepProgress
from omniocc.train.audit import audit
from omniocc.train.images import OccupancyImages
from omniocc.train.scene_counts import save_by_scene
from omniocc.train.submission import score_files


@dataclass(frozen=True)
class Evaluation:
    """What is scored, and how; see `python src/evaluate.py --help`.

    Attributes:
        checkpoints: files, those of shipped names included.
        overrides: of the configuration of the checkpoints.
        predictions: folder of files to be scored; None: checkpoints are tested.
        robustness: `all`, or names of parts; None: no robustness test.
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
        """Return the words of the command line by their meaning; what is a file or has no `=` is a checkpoint."""
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
        """Return why the words do not go together, None if they do."""
        if self.predictions is not None and (self.checkpoints or self.robustness is not None or self.audit):
            return "predictions=... scores files alone: leave checkpoints, robustness=... and --audit out"
        if self.robustness is not None and (self.audit or self.origins != "own"):
            return "robustness=... is a test of its own: leave --audit and --origins out"
        return None

    @property
    def suffix(self) -> str:
        """Return the end of a default folder of results, so that those from other origins stand beside the others."""
        return "" if self.origins == "own" else f"-{self.origins}"

    def run(self) -> None:
        """Score what is asked for; a checkpoint that cannot be scored is told after the others are.

        Raises:
            UserError, DataError: naming what cannot be scored.
        """
        if self.predictions is not None:
            return score_predictions(self)
        if not self.checkpoints:
            raise UserError("name a checkpoint, a shipped file of weights, or predictions=folder")
        return each(self.checkpoints, self._score)

    def _score(self, checkpoint: Path) -> None:
        several = len(self.checkpoints) > 1
        if several:
            print(f"\nsystem    {system_of(checkpoint)}", flush=True)
        trained = opened(checkpoint, self.overrides)
        if takes_true_range(trained.occupancy.sketch):
            raise UserError(
                f"{checkpoint} takes recorded ranges (model/depth=truth), which only train.py hands to it: its test is "
                "in table.md of its folder"
            )
        if self.audit:
            for name, value in audit(trained.task, trained.data):
                print(f"{name:58} {value}")
        else:
            folder = folder_of(checkpoint, f"{EVALUATION}{checkpoint.stem}{self.suffix}", self.output, several)
            test_again(trained, folder, self)


def opened(checkpoint: Path, overrides: Sequence[str]) -> Trained:
    """Return a checkpoint with overrides, of which `packages=[...]` allows classes of other packages."""
    packages = [word for word in overrides if word.startswith("packages=")]
    changes = [word for word in overrides if word not in packages]
    return load(checkpoint, changes, OmegaConf.from_dotlist(packages).get("packages", ()))


def each(checkpoints: Iterable[Path], score: Callable[[Path], None]) -> None:
    """Score one checkpoint after the other; raise UserError with all different messages at the end."""
    refused = []
    for checkpoint in checkpoints:
        try:
            score(checkpoint)
        except (UserError, OSError) as error:  # the others come first
            refused.append(str(error))
    if refused:
        raise UserError("\n".join(dict.fromkeys(refused)))


def test_again(trained: Trained, folder: Path, options: Evaluation) -> None:
    """Score a checkpoint on the test scenes; write figures, table and images."""
    task, data = trained.task, trained.data
    data.set_ray_origins(options.origins)
    folder.mkdir(parents=True, exist_ok=True)
    images = OccupancyImages(folder / IMAGES, options.images, data.spec.classes)
    trainer = Trainer(
        callbacks=[StepProgress("occupancy"), images],
        logger=False,
        enable_checkpointing=False,
        enable_model_summary=False,
        devices=1,
    )
    metrics = trainer.test(task, datamodule=data, verbose=False)[0]
    facts = {"checkpoint": str(trained.path), "commit": git_commit(), "data": data.source.fingerprint}
    facts |= {OVERRIDES: list(options.overrides), PROTOCOL: task.protocol}
    save_by_scene(folder, task.scores, data.source, task.counted)
    save_results(folder, metrics, facts)
    show_results(folder)


def folder_of(checkpoint: Path, name: str, output: Path | None, by_system: bool) -> Path:
    """Return the folder of results: `name` beside the checkpoint, or in `output`, where systems may have their own."""
    if output is not None:
        return output / system_of(checkpoint) / name if by_system else output
    return (Path("runs") if checkpoint.parent == SHIPPED else checkpoint.parent) / name


def score_predictions(options: Evaluation) -> None:
    """Score the files in a folder on the test scenes of the data that the overrides choose; write table and figures."""
    folder = options.predictions
    assert folder is not None
    source = Parts(compose_config(CONF, "train", options.overrides)).data().source
    source.prepare()
    metrics, protocol = score_files(source, folder, origins=options.origins)
    output = options.output or folder.with_name(f"{folder.name}-scores{options.suffix}")
    facts = {"predictions": str(folder), "commit": git_commit(), "data": source.fingerprint, PROTOCOL: protocol}
    save_results(output, metrics, facts)
    show_results(output)


def system_of(checkpoint: Path) -> str:
    """Return the name of a system: that of its run, or of the shipped weights."""
    return checkpoint.stem if checkpoint.parent == SHIPPED else checkpoint.absolute().parent.name
