"""How much training a stage asks for, in words, before it starts, and when it is validated."""

import math
from typing import NamedTuple

from omniocc.progress import clock

VALIDATIONS = 5
"""Most of a training that is limited by steps."""
LIGHTNING_EPOCHS = 1000
"""Epochs that Lightning trains when neither steps nor epochs are given."""


class Amount(NamedTuple):
    """How much training is asked for.

    Attributes:
        max_steps: optimiser steps; -1: as many as `max_epochs` are.
        max_epochs: passes over the frames; None or -1: as many as `max_steps` are; None without `max_steps`: 1,000.
        frames: of the training scenes.
        batch_size: samples per device and step.
        devices: in all machines.
        accumulated: batches per optimiser step.
        limit: most batches of a device in an epoch, or a fraction of them.
    """

    max_steps: int
    max_epochs: int | None
    frames: int
    batch_size: int
    devices: int
    accumulated: int
    limit: int | float = 1.0

    @property
    def samples(self) -> int:
        """Return the samples of a step, over all devices."""
        return self.batch_size * self.devices * self.accumulated

    @property
    def steps_of_epoch(self) -> int:
        """Return the optimiser steps of an epoch; the last incomplete one is left out."""
        batches = self.frames // self.samples * self.accumulated
        limited = min(self.limit, batches) if isinstance(self.limit, int) else int(self.limit * batches)
        return math.ceil(limited / self.accumulated)

    @property
    def steps(self) -> int | None:
        """Return the optimiser steps; None if nothing ends them."""
        epochs = LIGHTNING_EPOCHS if self.max_steps < 0 and self.max_epochs is None else self.max_epochs
        limits = [self.max_steps] if self.max_steps >= 0 else []
        if epochs is not None and epochs >= 0:
            limits.append(epochs * max(1, self.steps_of_epoch))
        return min(limits, default=None)

    @property
    def line(self) -> str:
        """Return steps, samples and epochs, for example `1000 steps of 2 samples: 5.0 epochs of 400 frames`."""
        if (steps := self.steps) is None:
            return f"without end, over {self.frames} frames"
        parts = [str(self.batch_size), *([f"{self.devices} devices"] if self.devices > 1 else [])]
        parts += [f"{self.accumulated} batches"] if self.accumulated > 1 else []
        epochs = f"{steps * self.samples / max(1, self.frames):.1f} epochs of {self.frames} frames"
        return f"{steps} steps of {' x '.join(parts)} samples: {epochs}"


def hours_line(steps: int | None, step_s: float) -> str:
    """Return the duration of a training, for example `0.35 s a step: 5:50 min`."""
    return f"{step_s:.2f} s a step: {'without end' if steps is None else clock(steps * step_s)}"


def validation_times(
    max_steps: int, max_epochs: int | None, every_n_epochs: int | None, accumulated: int
) -> dict[str, int | None]:
    """Return the arguments of Lightning's trainer that say when to validate, the last time at the end of training.

    Without `every_n_epochs`, a training that is limited by epochs is validated after each, and one that is limited by
    steps up to five times at equal distances; with it, `val_check_interval` of the trainer has an effect. Other
    arguments as in `Amount`.
    """
    if every_n_epochs is not None or max_epochs not in (None, -1) or max_steps < 1:
        return {"check_val_every_n_epoch": every_n_epochs or 1}
    times = max(count for count in range(1, VALIDATIONS + 1) if max_steps % count == 0)
    return {"check_val_every_n_epoch": None, "val_check_interval": max_steps // times * accumulated}  # batches
