"""Seconds spent in the steps of a prediction."""

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import torch


class Stopwatch:
    """Adds up the seconds of each step.

    Args:
        device: whose pending work is waited for at the end of a step.
        steps: their names, in the order in which they are printed.
    """

    def __init__(self, device: torch.device, steps: Sequence[str]):
        self.device = device
        self.seconds: dict[str, float] = dict.fromkeys(steps, 0.0)

    @contextmanager
    def __call__(self, step: str) -> Iterator[None]:
        """Add the duration of a block to a step."""
        began_s = time.perf_counter()
        yield
        if self.device.type == "cuda":
            torch.cuda.synchronize(self.device)
        self.seconds[step] += time.perf_counter() - began_s

    def __str__(self) -> str:
        return ", ".join(f"{step} {value:.2f} s" for step, value in self.seconds.items())
