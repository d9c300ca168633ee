"""The processes of a run on several devices: who is first, what it tells the others, and where they meet."""

import os
from typing import TypeVar

from torch import distributed

Value = TypeVar("Value")


def is_first() -> bool:
    """Return whether this is the first process of a run, the only one that writes files and prints."""
    # Lightning sets LOCAL_RANK for its children; Slurm starts all processes itself, at the same time
    return os.environ.get("LOCAL_RANK", os.environ.get("SLURM_PROCID", "0")) == "0"


def share() -> tuple[int, int]:
    """Return the number of this process and the number of processes; 0 and 1 as long as no others have joined."""
    if not distributed.is_initialized():
        return 0, 1
    return distributed.get_rank(), distributed.get_world_size()


def from_first(value: Value) -> Value:
    """Return the first process's value in all of them; the own one as long as no others have joined."""
    if not distributed.is_initialized():
        return value
    values = [value]
    distributed.broadcast_object_list(values, src=0)
    return values[0]


def meet() -> None:
    """Wait until all processes are here."""
    if distributed.is_initialized():
        distributed.barrier()
