"""The machine of a run, in words."""

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
    lines = CPU_INFO.read_text().splitlines() if CPU_INFO.exists() else []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.machine()
