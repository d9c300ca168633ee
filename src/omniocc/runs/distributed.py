"""The processes of a run on several devices: who is first, what it tells the others, and where they meet."""

import os
from typing import Any, TypeVar

from torch import distributed

Value = TypeVar("Value")


def is_first() -> bool:
    """Return whether this is the first process of a run on all its machines, the only one that writes and prints."""
    given = os.environ
    if "RANK" in given:  # torchrun numbers the processes of all machines
        return given["RANK"] == "0"
    # Lightning sets LOCAL_RANK for its children; Slurm starts all processes itself, at the same time
    place = given.get("LOCAL_RANK", given.get("SLURM_PROCID", "0"))
    return given.get("NODE_RANK", given.get("GROUP_RANK", "0")) == "0" and place == "0"


def started_by_others() -> bool:
    """Return whether several processes of this run were started by torchrun or Slurm, none of them by another."""
    given = os.environ
    if "RANK" in given:
        return given.get("WORLD_SIZE", "1") != "1"
    return "SLURM_PROCID" in given and "LOCAL_RANK" not in given and given.get("SLURM_NTASKS", "1") != "1"


def rank_and_world_size() -> tuple[int, int]:
    """Return the number of this process and the number of processes; 0 and 1 as long as no others have joined."""
    if not distributed.is_initialized():
        return 0, 1
    return distributed.get_rank(), distributed.get_world_size()


def broadcast(value: Value) -> Value:
    """Return the first process's value in all of them; the own one as long as no others have joined."""
    if not distributed.is_initialized():
        return value
    values = [value]
    distributed.broadcast_object_list(values, src=0)
    return values[0]


def all_gather(value: Value) -> list[Value]:
    """Return the values of all processes, which have to call this together; the own one as long as no others joined."""
    if not distributed.is_initialized():
        return [value]
    values: list[Any] = [None] * distributed.get_world_size()
    distributed.all_gather_object(values, value)
    return values


def barrier() -> None:
    """Wait until all processes are here."""
    if distributed.is_initialized():
        distributed.barrier()
