"""The cost of a model: parameters, operations and memory."""

import resource
from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor, nn
from torch.utils.flop_counter import FlopCounterMode

from omniocc.data.dataset import Sample
from omniocc.model import OccupancyModel, Stream
from omniocc.model.protocols import Sketched, learns, takes_true_range

PARAMETERS, GFLOP, PEAK = "million parameters", "GFLOP a frame", "peak MiB"


def bag_flops(table: Tensor, rows: Tensor, *arguments: Any, **options: Any) -> int:
    """Return the operations of an embedding bag: one table row is multiplied and added per entry."""
    return 2 * rows.numel() * table.shape[1]


def product_flops(*operands: Tensor, **options: Any) -> int:
    """Return the operations of a product of the last two matrices, which may be added to a bias at no cost.

    Of a sparse matrix only stored entries count.
    """
    left, right = operands[-2:]
    entries = left._nnz() if left.layout != torch.strided else left.numel()
    return 2 * entries * right.shape[1]


for formula in (bag_flops, product_flops):
    formula._get_raw = True  # type: ignore[attr-defined]
FORMULAS = {
    torch.ops.aten._embedding_bag: bag_flops,
    torch.ops.aten._embedding_bag_forward_only: bag_flops,
    torch.ops.aten.mm: product_flops,
    torch.ops.aten.addmm: product_flops,
}


def count_gflop(run: Callable[[], object]) -> float:
    """Return billions of floating-point operations without backward; a multiplication and an addition are two."""
    with FlopCounterMode(display=False, custom_mapping=FORMULAS) as counter, torch.no_grad():
        run()
    return counter.get_total_flops() / 1e9


def cost_of(model: OccupancyModel, sample: Sample) -> dict[str, float]:
    """Return parameters, and operations of one more frame of a sequence; a learned sketch and its depth count in both.

    Recorded ranges (`model/depth=truth`) cost nothing. The frame is the newest of the sample; the model has to be in
    evaluation mode.
    """
    device = next(model.parameters()).device
    images, pose = sample.images[-1].to(device), sample.world_from_ego[-1].to(device)
    parts = [None if part is None else part[-1:].to(device) for part in (sample.candidates, sample.evidence)]
    sketched = None if parts[0] is None else Sketched(parts[0], parts[1])
    stream = Stream(model)
    runs: list[Callable[[], object]] = [lambda: stream.step(images, sample.rigs[-1], pose, sketched)]
    if sketched is not None and estimates_range(model):
        runs.append(lambda: model.propose(images[None], (sample.rigs[-1],)))
    for _ in range(model.temporal.frames - 1):  # the window is full when the counted frame comes
        count_gflop(runs[0])
    return cost_of_network(model, *runs)


def cost_of_network(network: nn.Module, *runs: Callable[[], object]) -> dict[str, float]:
    """Return the parameters of a network, and the operations of runs that compute a frame together.

    They run twice: the first time makes tables of the rig, which belong to no frame.
    """
    for run in runs:
        count_gflop(run)
    parameters = sum(parameter.numel() for parameter in network.parameters())
    return {PARAMETERS: round(parameters / 1e6, 3), GFLOP: round(sum(map(count_gflop, runs)), 4)}


def estimates_range(model: OccupancyModel) -> bool:
    """Return whether the sketch uses ranges that a depth option estimates, rather than recorded ones."""
    return learns(type(model.sketch)) and not takes_true_range(model.sketch)


def peak_mib(device: torch.device) -> float:
    """Return the peak memory on a GPU, or of this process, MiB."""
    if device.type == "cuda":
        return round(torch.cuda.max_memory_allocated(device) / 2**20)
    return round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**10)
