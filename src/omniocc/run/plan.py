"""How much training a stage asks for, in words, before it starts, and when it is validated."""

import math
from collections.abc import Mapping
from typing import Any

from omniocc.progress import clock

VALIDATIONS = 5
"""Most of a training that is limited by steps."""
LIGHTNING_EPOCHS = 1000
"""Epochs that Lightning trains when neither steps nor epochs are given."""


def planned_steps(
    max_steps: int, max_epochs: int | None, frames: int, batch_size: int, devices: int, accumulated: int
) -> int | None:
    """Return the optimiser steps of a training; None if nothing ends it.

    Args:
        max_steps: optimiser steps; -1: as many as `max_epochs` are.
        max_epochs: passes over the frames; None or -1: as many as `max_steps` are; None without `max_steps`: 1,000.
        frames: of the training scenes.
        batch_size: samples per device and step.
        devices: in all machines.
        accumulated: batches per optimiser step.
    """
    if max_steps < 0 and max_epochs is None:
        max_epochs = LIGHTNING_EPOCHS
    batches = frames // devices // batch_size
    per_epoch = max(1, math.ceil(batches / accumulated))
    limits = [max_steps] if max_steps >= 0 else []
    limits += [max_epochs * per_epoch] if max_epochs is not None and max_epochs >= 0 else []
    return min(limits, default=None)


def plan_line(
    max_steps: int, max_epochs: int | None, frames: int, batch_size: int, devices: int, accumulated: int
) -> str:
    """Return steps, samples and epochs of a training, for example `1000 steps of 2 samples: 5.0 epochs of 400 frames`.

    Arguments as in `planned_steps`.
    """
    steps = planned_steps(max_steps, max_epochs, frames, batch_size, devices, accumulated)
    if steps is None:
        return f"without end, over {frames} frames"
    samples = batch_size * devices * accumulated
    parts = [str(batch_size), *([f"{devices} devices"] if devices > 1 else [])]
    parts += [f"{accumulated} batches"] if accumulated > 1 else []
    together = " x ".join(parts)
    return f"{steps} steps of {together} samples: {steps * samples / max(1, frames):.1f} epochs of {frames} frames"


def hours_line(steps: int | None, step_s: float) -> str:
    """Return the duration of a training, for example `0.35 s a step: 5:50 min`."""
    return f"{step_s:.2f} s a step: {'without end' if steps is None else clock(steps * step_s)}"


def validation_times(trainer: Mapping[str, Any]) -> dict[str, int | None]:
    """Return the arguments of the trainer that say when to validate, so that the last time is the end of training.

    `check_val_every_n_epoch` of the configuration is kept. Where it is null, a training that is limited by epochs is
    validated after each, and one that is limited by steps up to five times at equal distances.
    """
    epochs, steps = trainer["check_val_every_n_epoch"], trainer["max_steps"]
    if epochs is not None or trainer["max_epochs"] not in (None, -1) or steps < 1:
        return {"check_val_every_n_epoch": epochs or 1}
    times = max(count for count in range(1, VALIDATIONS + 1) if steps % count == 0)
    interval = steps // times * trainer["accumulate_grad_batches"]  # batches
    return {"check_val_every_n_epoch": None, "val_check_interval": interval}
