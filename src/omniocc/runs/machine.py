"""The machine of a run, in words."""

import ctypes
import os
import platform
from pathlib import Path

import torch

from omniocc.parallel import usable_cores

MACHINE = "machine"
"""Fact of runs: processor, cores and version of torch."""
CPU_INFO = Path("/proc/cpuinfo")


def machine(device: torch.device) -> str:
    """Return the kind of GPU, if one is used, and of processor, the usable cores, and the version of torch."""
    gpu = [torch.cuda.get_device_name(device)] if device.type == "cuda" else []
    return ", ".join([*gpu, processor(), f"{usable_cores()} cores", f"torch {torch.__version__}"])


def processor() -> str:
    """Return the name of the processor, or what Python calls it where Linux does not tell."""
    lines = CPU_INFO.read_text("utf-8").splitlines() if CPU_INFO.exists() else []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.machine()


def memory_bytes(device: torch.device) -> int:
    """Return the whole memory of a GPU, or of this machine."""
    if device.type == "cuda":
        return torch.cuda.get_device_properties(device).total_memory
    return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")


M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3
"""Numbers of the options in glibc's malloc.h."""
LARGEST_BLOCK, LARGEST_REST = 2**30, 2**31 - 1
"""Bytes of the largest block that is reused, and of the most that is kept: the largest that mallopt's int holds."""


def keep_freed_memory() -> None:
    """Let glibc reuse freed blocks of up to 1 GiB, since returning tensors to the system after every step is slow.

    The process then keeps its peak memory. Other C libraries are not changed.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        mallopt(M_MMAP_THRESHOLD, LARGEST_BLOCK)
        mallopt(M_TRIM_THRESHOLD, LARGEST_REST)
