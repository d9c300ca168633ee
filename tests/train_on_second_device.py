"""Run `src/train.py` on the simulated second device: `python tests/train_on_second_device.py preset=smoke [...]`."""

import functools
import runpy
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import torch
from lightning.pytorch import Trainer
from lightning.pytorch.accelerators import CPUAccelerator
from lightning.pytorch.strategies import SingleDeviceStrategy

SCRIPT = Path(__file__).parents[1] / "src" / "train.py"
sys.path[:0] = [str(Path(__file__).parent), str(SCRIPT.parent)]

from second_device import CUDA, SecondDevice  # noqa: E402


class Accelerator(CPUAccelerator):
    """A CPU that accepts the second device."""

    def setup_device(self, device: object) -> None:
        """Do nothing."""


create = Trainer.__init__


@functools.wraps(create)
def create_there(self: Trainer, *args: Any, **options: Any) -> None:
    """Make a trainer on the second device, whatever the configuration says."""
    options |= {"strategy": SingleDeviceStrategy(device=CUDA, accelerator=Accelerator()), "devices": 1}
    options.pop("accelerator", None)
    create(self, *args, **options)


if __name__ == "__main__":
    Trainer.__init__ = create_there  # type: ignore[method-assign]
    torch.cuda.get_device_name = lambda device=None: "simulated second device"
    torch.cuda.get_device_properties = lambda device=None: SimpleNamespace(total_memory=2**37)
    sys.argv[0] = str(SCRIPT)
    with SecondDevice():
        runpy.run_path(sys.argv[0], run_name="__main__")
