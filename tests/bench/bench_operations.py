"""Operations of a frame and of a training step: `python tests/bench/bench_operations.py [key=value ...] [--lines 20]`.

A GPU waits for operations to be started where they are small, which seconds on a CPU do not show. They are counted on
the simulated second device, so that no GPU is needed: all that PyTorch dispatches; those that start a kernel, without
views and empty tensors; those for which the processor waits. A frame is the fourth of a sequence of noise, predicted by
the weights `tiny`; its results are copied to the processor afterwards. A step of each stage is the third on noise, with
clipping and optimiser. `--lines` lists the source lines that start most kernels.
"""

import argparse
import logging
import sys
import warnings
from pathlib import Path
from typing import Any

import torch
from hydra import compose, initialize_config_dir
from lightning.pytorch import Callback
from lightning.pytorch.strategies import SingleDeviceStrategy
from torch.utils.data import DataLoader

sys.path.insert(0, str(Path(__file__).parents[1]))
from operations import Operations
from second_device import CUDA, SecondDevice
from train_on_second_device import Accelerator

from omniocc import load
from omniocc.batch import to_device
from omniocc.camera import Rig
from omniocc.data.source.cameras import training_rig
from omniocc.parts import Parts
from omniocc.predict.predictor import STEPS, Input, Predictor
from omniocc.predict.stopwatch import Stopwatch
from omniocc.train.command import random_batch
from omniocc.train.stage import Stage
from omniocc.train.stages import stages_of

CONF = Path(__file__).parents[2] / "conf"
WARM_UP_FRAMES, WARM_UP_STEPS = 3, 2


def operations_of_frame(weights: str) -> Operations:
    """Return the operations of a frame whose tables of the rig are made and whose past is there."""
    rig, watch = Rig.load("fisheye6").resized(256, 144), Stopwatch(torch.device("cpu"), STEPS)
    with SecondDevice():
        predictor = Predictor(load(weights).occupancy, None, (), CUDA)
        for frame in range(WARM_UP_FRAMES):
            predictor.step(noise(rig, frame), watch)
        with Operations() as operations:
            predictor.step(noise(rig, WARM_UP_FRAMES), watch)
    return operations


def noise(rig: Rig, frame: int) -> Input:
    """Return a frame of noise, a metre ahead of the one before."""
    pose = torch.eye(4, dtype=torch.float64)
    pose[0, 3] = frame
    return Input(torch.rand(1, len(rig.cameras), 3, rig.cameras[0].height, rig.cameras[0].width), rig, pose)


class CountStep(Callback):
    """Counts the operations of one step."""

    def __init__(self, step: int):
        self.step, self.operations = step, Operations()

    def on_train_batch_start(self, trainer: Any, pl_module: Any, batch: Any, batch_idx: int) -> None:
        """Begin to count."""
        if batch_idx == self.step:
            self.operations.__enter__()

    def on_train_batch_end(self, trainer: Any, pl_module: Any, outputs: Any, batch: Any, batch_idx: int) -> None:
        """End the count."""
        if batch_idx == self.step:
            self.operations.__exit__(None, None, None)


def operations_of_step(stage: Stage) -> Operations:
    """Return the operations of a training step of a stage."""
    rig, steps = training_rig(stage.data.source), WARM_UP_STEPS + 1
    task, batch, count = stage.task(rig), random_batch(stage, rig), CountStep(WARM_UP_STEPS)
    task.transfer_batch_to_device = lambda batch, device, _: to_device(batch, device)
    with SecondDevice():
        trainer = stage.parts.trainer(
            max_steps=steps,
            limit_val_batches=0,
            logger=False,
            enable_checkpointing=False,
            enable_progress_bar=False,
            callbacks=[count],
            accelerator="auto",
            strategy=SingleDeviceStrategy(device=CUDA, accelerator=Accelerator()),
        )
        trainer.fit(task, DataLoader([batch] * steps, batch_size=None, collate_fn=lambda batch: batch))
    return count.operations


def show(title: str, operations: Operations, lines: int) -> None:
    """Print a table by slot, and the lines that start most kernels and that wait."""
    print(f"\n| {title} | operations | kernels | waits |\n|---|---:|---:|---:|")
    for slot in ("all", *(slot for slot, _ in operations.kernels.most_common())):
        counts = [count.total() if slot == "all" else count[slot] for count in counts_of(operations)]
        print(f"| {slot} | {' | '.join(f'{count:,}' for count in counts)} |")
    for heading, counted in (("kernels", operations.lines), ("waits", operations.waiting_lines)):
        for (slot, line, name), count in counted.most_common(lines):
            print(f"  {heading} {count:4} {slot}: {line} {name}")


def counts_of(operations: Operations) -> tuple[Any, ...]:
    """Return the three columns of the table."""
    return operations.total, operations.kernels, operations.waits


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("overrides", nargs="*", help="of the training steps; default: preset=tiny")
    parser.add_argument("--lines", default=0, type=int)
    chosen = parser.parse_args()
    warnings.filterwarnings("ignore")
    logging.getLogger("lightning.pytorch").setLevel(logging.ERROR)
    torch.set_num_threads(1)
    torch.manual_seed(0)
    show("frame", operations_of_frame("tiny"), chosen.lines)
    with initialize_config_dir(str(CONF), version_base="1.3"):
        parts = Parts(compose("train", ["preset=tiny", *chosen.overrides]))
    for stage in stages_of(parts, parts.data()):
        if stage.learns:
            show(f"step of {stage.NAME}", operations_of_step(stage), chosen.lines)


if __name__ == "__main__":
    main()
