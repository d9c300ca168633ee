"""Options of `view.py`."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from itertools import count
from pathlib import Path
from typing import Any, TypeVar

from omegaconf import DictConfig

from omniocc.config import as_options
from omniocc.errors import UserError

Options = TypeVar("Options", "ViewOptions", "TargetOptions")


@dataclass(frozen=True)
class ViewOptions:
    """Options that choose which frames are shown; see `conf/view.yaml`."""

    run: Sequence[str] = ()
    recorded: str | None = None
    predictions: str | None = None
    scene: str | None = None
    frames: Sequence[int] | None = None
    limit: int | None = 20
    device: str | None = None

    def __post_init__(self) -> None:
        """Check that the options fit together; raise UserError naming those that do not."""
        if self.predictions is not None and (self.run or self.recorded):
            raise UserError("predictions=... are shown as they are: leave run=... and recorded=... out")
        if not (self.run or self.recorded or self.predictions):
            raise UserError(
                "nothing to show: give run=runs/<run> (or run=tiny), recorded=<scenes> or predictions=<folder>; "
                "python src/view.py --help explains them"
            )
        if self.limit is not None and self.limit < 1:
            raise UserError(f"limit={self.limit}: give at least 1 frame, or limit=null for all")


@dataclass(frozen=True)
class TargetOptions:
    """Options that choose where frames are shown; see `conf/view.yaml`."""

    save: str | None = None
    connect: str | None = None
    page: bool = False
    output: str | None = None
    watch: str | None = None
    port: int = 8080
    wandb: bool = False

    def __post_init__(self) -> None:
        """Check that the options fit together; raise UserError naming those that do not."""
        given = {"save": self.save, "connect": self.connect, "page": self.page, "watch": self.watch}
        chosen = [key for key, value in given.items() if value]
        if len(chosen) > 1:
            raise UserError(f"{' and '.join(f'{key}=...' for key in chosen)} are different places: give one of them")
        if self.wandb and not (self.save or self.page):
            raise UserError("wandb=true keeps a file: give save=view.rrd or page=true")
        if self.output is not None and not self.page:
            raise UserError(f"output={self.output} is the file of a page: give page=true too")
        if self.save is not None and Path(self.save).is_dir():
            raise UserError(f"save={self.save} is a folder; give a file, {Path(self.save) / 'view.rrd'}")
        if not 0 <= self.port < 65536:
            raise UserError(f"port={self.port}: give a port from 0 (any that is free) to 65535")


def options_of(cfg: DictConfig) -> tuple[ViewOptions | None, TargetOptions]:
    """Return the checked options of `conf/view.yaml`: what is shown (None with `watch`), and where.

    Raises:
        UserError: naming the option that is contradictory, missing or of the wrong type.
    """
    values = {str(key): value for key, value in cfg.items()}
    values["run"] = [cfg.run] if isinstance(cfg.run, str) else cfg.run if cfg.run is not None else []
    target = _build(TargetOptions, values)
    if target.wandb and not (values["run"] and Path(values["run"][0]).is_dir()):
        raise UserError("wandb=true keeps the file with a run: give run=runs/<run>, the run's folder")
    if target.watch is None:
        return _build(ViewOptions, values), target
    default = ViewOptions(run=("any",))  # without a run the constructor raises
    names = [field.name for field in fields(ViewOptions)]
    given = [name for name in names if values[name] not in ([], getattr(default, name))]
    if given:
        raise UserError(f"watch={target.watch} follows runs in progress: leave {', '.join(given)} out")
    return None, target


def _build(kind: type[Options], values: dict[str, Any]) -> Options:
    """Return an instance of `kind` from the values of its fields, whose types are checked."""
    return as_options(kind, "view", {field.name: values[field.name] for field in fields(kind)})


def unique_names(runs: Sequence[str]) -> list[str]:
    """Return a short name for each run: the name of its folder, with a number where an earlier run has that name."""
    names: list[str] = []
    for run in runs:
        path = Path(run)
        name = path.parent.name if path.suffix and path.parent.name else path.name
        candidates = (name if number == 1 else f"{name} ({number})" for number in count(1))
        names.append(next(candidate for candidate in candidates if candidate not in names))
    return names
