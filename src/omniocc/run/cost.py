"""What a model costs, told beside its scores."""

import resource
from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor
from torch.utils.flop_counter import FlopCounterMode

from omniocc.data.dataset import Sample
from omniocc.model import OccupancyModel, Stream
from omniocc.model.occupancy import to_unit_range
from omniocc.model.sketch import LearnedSketch, Sketched

PARAMETERS, GFLOP, PEAK = "million parameters", "GFLOP a frame", "peak MiB"


def bag_flops(table: Tensor, rows: Tensor, *arguments: Any, **options: Any) -> int:
    """A bag multiplies and adds one table row per entry."""
    return 2 * rows.numel() * table.shape[1]


def product_flops(left: Tensor, right: Tensor, **options: Any) -> int:
    """Of a sparse matrix only the entries that are stored count."""
    stored = left._nnz() if left.layout != torch.strided else left.numel()
    return 2 * stored * right.shape[1]


def added_product_flops(bias: Tensor, left: Tensor, right: Tensor, **options: Any) -> int:
    """As `product_flops`."""
    return product_flops(left, right)


for formula in (bag_flops, product_flops, added_product_flops):
    formula._get_raw = True  # type: ignore[attr-defined]
FORMULAS = {
    torch.ops.aten._embedding_bag: bag_flops,
    torch.ops.aten._embedding_bag_forward_only: bag_flops,
    torch.ops.aten.mm: product_flops,
    torch.ops.aten.addmm: added_product_flops,
}


def count_gflop(run: Callable[[], object]) -> float:
    """Billions of floating-point operations without backward; a multiplication and an addition are two."""
    with FlopCounterMode(display=False, custom_mapping=FORMULAS) as counter, torch.no_grad():
        run()
    return counter.get_total_flops() / 1e9


def cost_of(model: OccupancyModel, sample: Sample) -> dict[str, float]:
    """Parameters, and operations of one more frame of a drive; a learned sketch and its depth are part of both.

    Recorded ranges (`model/depth=truth`) cost nothing.

    Args:
        model: in evaluation mode.
        sample: whose newest frame is looked at.
    """
    device = next(model.parameters()).device
    images, pose = sample.images[-1].to(device), sample.world_from_ego[-1].to(device)
    sketched = None if sample.candidates is None else Sketched(sample.candidates[-1:].to(device))
    stream = Stream(model)
    runs: list[Callable[[], object]] = [lambda: stream.step(images, sample.rig, pose, sketched)]
    if sketched is not None and isinstance(model.sketch, LearnedSketch) and not model.sketch.depth.NEEDS_TRUE_RANGE:
        runs.append(lambda: model.choose(to_unit_range(images)[None], (sample.rig,)))
    once_and_past = [*runs, *runs[:1] * (model.temporal.frames - 1)]
    for run in once_and_past:  # what is computed once for a rig belongs to no frame
        count_gflop(run)
    parameters = sum(parameter.numel() for parameter in model.parameters())
    return {PARAMETERS: round(parameters / 1e6, 3), GFLOP: round(sum(map(count_gflop, runs)), 4)}


def peak_mib(device: torch.device) -> float:
    """The most memory that was held on a GPU, or by this process."""
    if device.type == "cuda":
        return round(torch.cuda.max_memory_allocated(device) / 2**20)
    return round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**10)
