"""How much training a stage asks for, in words, before it starts."""

import math


def plan_line(
    max_steps: int, max_epochs: int | None, frames: int, batch_size: int, devices: int, accumulated: int
) -> str:
    """Return steps, samples and epochs of a training, for example `1000 steps of 2 samples: 5.0 epochs of 400 frames`.

    Args:
        max_steps: optimiser steps; -1: as many as `max_epochs` are.
        max_epochs: passes over the frames; None or -1: as many as `max_steps` are.
        frames: of the training scenes.
        batch_size: samples per device and step.
        devices: in all machines.
        accumulated: batches per optimiser step.
    """
    batches = frames // devices // batch_size
    per_epoch = max(1, math.ceil(batches / accumulated))
    limits = [max_steps] if max_steps >= 0 else []
    limits += [max_epochs * per_epoch] if max_epochs is not None and max_epochs >= 0 else []
    if not limits:
        return f"without end, over {frames} frames"
    steps, samples = min(limits), batch_size * devices * accumulated
    parts = [str(batch_size), *([f"{devices} devices"] if devices > 1 else [])]
    parts += [f"{accumulated} batches"] if accumulated > 1 else []
    together = " x ".join(parts)
    return f"{steps} steps of {together} samples: {steps * samples / max(1, frames):.1f} epochs of {frames} frames"
