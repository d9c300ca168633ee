"""What a training starts from: another run with its optimiser, or weights alone."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, cast

from torch import nn

from omniocc.config import dotted, plain, target_of
from omniocc.errors import UserError
from omniocc.model import OccupancyModel
from omniocc.model.protocols import LearnedSketch
from omniocc.runs.checkpoint import Checkpoint, load_checkpoint, part_weights
from omniocc.runs.folder import given_checkpoint
from omniocc.train.occupancy import OccupancyTask
from omniocc.train.stage_task import Recipe

NAMED = 3
"""Names listed in a message, at most."""


def load_first_weights(
    model: nn.Module, recipe: Recipe, stage: str, checkpoint: Path | None, config: Mapping[str, Any]
) -> str | None:
    """Load the weights with which a stage begins: those that are given, or of its checkpoint where nothing is trained.

    A checkpoint that training goes on from is left to the trainer. `config` is the resolved configuration.

    Returns:
        A line on how the network that the given weights are from differs; None where it does not.
    """
    if checkpoint is None:
        return None if recipe.weights is None else start_from(model, recipe.weights, stage, config)
    if not recipe.max_steps:
        model.load_state_dict(load_checkpoint(checkpoint).model_weights)
    return None


def start_from(model: nn.Module, weights: str, stage: str, config: Mapping[str, Any]) -> str | None:
    """Load a stage's weights from a checkpoint of it or a later stage; the depth in a sketch keeps those that it has.

    What a network has more than that of the checkpoint, and adds nothing at first, keeps its first weights.
    Weights can fit a network that computes something else from them, because it pairs other cameras, for example.

    Returns:
        A line with the keys in which the two networks differ; None without any.

    Raises:
        UserError: when the checkpoint does not hold the stage, or its weights do not fit.
    """
    trained = load_checkpoint(weights)
    own = part_weights(trained, stage)
    place, left_out = _network(stage, config)
    other = list(_differing(*(_part(one, place, left_out) for one in (plain(trained.config), config))))
    inner, new = model.state_dict(), tuple(getattr(model, "ADDS_NOTHING_AT_FIRST", ()))
    own |= {name: value for name, value in inner.items() if stage == "sketch" and name.startswith("depth.")}
    own |= {name: value for name, value in inner.items() if name.startswith(new) and name not in own}
    try:
        model.load_state_dict(own)
    except RuntimeError as error:
        first = str(error).splitlines()[1:2] or [str(error)]
        keys = f" Give the values that it has there: {'; '.join(other)}" if other else ""
        raise UserError(
            f"stages.{stage}.weights={weights} do not fit this {stage} network: {first[0].strip()}{keys}"
        ) from error
    return (
        f"stages.{stage}.weights={weights} fit; they were trained with other values: {'; '.join(other)}"
        if other
        else None
    )


def check_resumed(path: Path, config: Mapping[str, Any], steps: int | None) -> None:
    """Check that a training can go on from a checkpoint, with its optimiser and step, as `resume=<checkpoint>` asks.

    Args:
        path: of the checkpoint.
        config: the resolved configuration of the training.
        steps: optimiser steps after which it ends; None: nothing ends it.

    Raises:
        UserError: when the file holds weights alone or another stage, network or optimiser differs, or no step is left.
    """
    trained = _occupancy_checkpoint(path, "resume")
    instead = f"weights={path} takes its weights and begins at step 0"
    if trained.step is None:
        raise UserError(f"resume={path}: it holds weights alone, without optimiser; {instead}")
    if changed := list(_changed(trained, config)):
        raise UserError(
            f"resume={path} goes on with the network and the optimiser of that run, which differ here: "
            f"{_some(changed)}. Give its values, or start anew: {instead}"
        )
    if steps is not None and trained.step >= steps:
        raise UserError(
            f"resume={path}: {trained.step} steps are done and the training ends after {steps}; "
            "give a larger stages.occupancy.max_steps"
        )


def check_weights(weights: str, resume: str) -> None:
    """Check that weights from which the occupancy model is to start (`weights=...`) exist and are of that stage.

    Raises:
        FileNotFoundError: when there is no such file.
        UserError: when they are damaged or of another stage, or `resume` names a checkpoint as well.
    """
    if given_checkpoint(resume) is not None:
        raise UserError(f"resume={resume} has weights of its own: leave it out, or leave out weights={weights}")
    _occupancy_checkpoint(weights, "weights")


def load_fitting(model: OccupancyModel, weights: str, config: Mapping[str, Any]) -> str:
    """Load the weights of another model that have the name and shape of this one's; return a line that says which.

    The sketch keeps its own, those of its stage, and the classifier the frequencies of the classes in its own data.

    Args:
        model: gets the weights.
        weights: checkpoint of the occupancy stage, or name of shipped weights.
        config: the resolved configuration; the line says in which keys its grid differs.

    Raises:
        UserError: when none fits.
    """
    trained = _occupancy_checkpoint(weights, "weights")
    given, counted = trained.model_weights, [f"classifier.{name}" for name in model.classifier.COUNTED]
    own = {name: value for name, value in model.state_dict().items() if not name.startswith(("sketch.", *counted))}
    fitting = {name: given[name] for name in own if name in given and given[name].shape == own[name].shape}
    if not fitting:
        raise UserError(f"weights={weights}: none of its weights has the name and shape of one of this model")
    model.load_state_dict(fitting, strict=False)
    line = f"{len(fitting)} of {len(own)} tensors from {weights}"
    if missing := [name for name in own if name not in fitting]:
        line += f"; new are {_some(missing)}"
    other = list(_differing(*(_part(one, "model.geometry") for one in (plain(trained.config), config))))
    return f"{line}; another grid: {'; '.join(other)}" if other else line


def _occupancy_checkpoint(given: str | Path, key: str) -> Checkpoint:
    trained = load_checkpoint(given)
    if trained.stage != OccupancyTask.STAGE:
        raise UserError(
            f"{key}={trained.path} is a checkpoint of the {trained.stage} stage, and this needs one of the occupancy "
            f"stage; the {trained.stage} stage starts from it by stages.{trained.stage}.weights=..."
        )
    return trained


def _changed(trained: Checkpoint, config: Mapping[str, Any]) -> Iterator[str]:
    """Yield the keys, with both values, in which the network or the optimiser of two configurations differ.

    Keys that only one of them has are left out, as another version or option has other keys; another option still shows
    by its class, the value of `_target_`.
    """
    return _differing(_continued(plain(trained.config)), _continued(config))


def _differing(theirs: Mapping[str, Any], ours: Mapping[str, Any]) -> Iterator[str]:
    """Yield the keys that both have and in which they differ, with both values."""
    for key, value in ours.items():
        if theirs.get(key, value) != value:
            yield f"{key}={value} (there {theirs[key]})"


def _network(stage: str, config: Mapping[str, Any]) -> tuple[str, tuple[str, ...]]:
    """Return where a configuration has a stage's network, and the arguments there on which no weight depends."""
    if stage == "depth":
        return "depth", ("loss",)
    selection = cast(type[LearnedSketch], target_of(config["model"]["sketch"])).SELECTION
    return "model.sketch", ("loss", "depth", *selection)


def _part(config: Mapping[str, Any], place: str, left_out: tuple[str, ...] = ()) -> dict[str, Any]:
    """Return by dotted key what a configuration has at a place, without some of the arguments there."""
    found = {key: value for key, value in dotted(config).items() if key.startswith(f"{place}.")}
    return {key: found[key] for key in found if key.removeprefix(f"{place}.").partition(".")[0] not in left_out}


def _continued(config: Mapping[str, Any]) -> dict[str, Any]:
    """Return by dotted key what a training cannot change when it goes on from a checkpoint."""
    parts = dotted({key: config[key] for key in ("model", "optimizer")})
    return parts | {key: config.get(key) for key in ("ema_decay", "lr_multipliers")}


def _some(names: list[str]) -> str:
    more = f" and {len(names) - NAMED} more" if len(names) > NAMED else ""
    return ", ".join(names[:NAMED]) + more
