"""What a frame of a stream asks of a GPU, counted on the simulated second device."""

import pytest
import torch
from operations import Operations
from second_device import CUDA, SecondDevice

from omniocc import load
from omniocc.camera import Rig
from omniocc.predict.predictor import STEPS, Input, Predictor
from omniocc.predict.stopwatch import Stopwatch

KERNELS = 625
"""Most kernels that a frame of the weights `tiny` may start; `tests/bench/bench_operations.py` lists them."""


@pytest.mark.slow(5)
def test_a_frame_waits_for_nothing_and_starts_few_kernels():
    rig, watch = Rig.load("fisheye6").resized(256, 144), Stopwatch(torch.device("cpu"), STEPS)
    # the stopwatch is the CPU's: a GPU's waits at the end of every step that it measures
    with SecondDevice():
        predictor, poses = Predictor(load("tiny").occupancy, None, (), CUDA), torch.eye(4).double().repeat(3, 1, 1)
        poses[:, 0, 3] = torch.arange(3)
        for pose in poses[:2]:  # tables of the rig, and the past
            predictor.step(Input(torch.rand(1, 6, 3, 144, 256), rig, pose), watch)
        with Operations() as operations:
            predictor.step(Input(torch.rand(1, 6, 3, 144, 256), rig, poses[2]), watch)
    assert operations.waiting_lines == {}
    assert 0 < operations.kernels.total() <= KERNELS, operations.lines.most_common(20)
