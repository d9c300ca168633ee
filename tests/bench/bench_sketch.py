"""Cost of the sketch network: `python tests/bench/bench_sketch.py [threads] [repeats]`.

Depth is left out: ranges are given. Every row runs in a process of its own, so that peak memory is its own; 'before' is
the memory of the process once the network is built. Operations are those of convolutions and matrix products, a
multiply and an add being two. Milliseconds are CPU time, the median of the repeats.
"""

import multiprocessing
import resource
import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import torch
from torch import nn
from torch.utils.flop_counter import FlopCounterMode

sys.path.insert(0, str(Path(__file__).parents[2] / "src"))

from omniocc.camera import Equirectangular
from omniocc.geometry import Cuboid, Cylinder
from omniocc.model.sketch import Omni


class Size(NamedTuple):
    """Sizes of one row."""

    name: str
    grid: Cylinder | Cuboid
    erp_size: tuple[int, int]
    channels: list[int]
    batch: int


SIZES = [
    Size("tiny", Cylinder((64, 100, 8)), (192, 48), [8, 16, 32], 1),
    Size("tiny", Cylinder((64, 100, 8)), (192, 48), [8, 16, 32], 2),
    Size("tiny cuboid", Cuboid((80, 80, 8)), (192, 48), [8, 16, 32], 2),
    Size("paper", Cylinder((128, 200, 16)), (720, 180), [8, 16, 32], 1),
    Size("paper", Cylinder((128, 200, 16)), (720, 180), [16, 32, 64, 128], 1),
    Size("paper cuboid", Cuboid((256, 256, 16)), (720, 180), [16, 32, 64, 128], 1),
]


class GivenRanges(nn.Module):
    """Take the place of depth, with nothing but its panorama."""

    def __init__(self, panorama: Equirectangular):
        super().__init__()
        self.panorama = panorama


def median_ms(run: Callable[[], object], repeats: int) -> float:
    """Return the CPU time of one run."""
    spent = []
    for _ in range(repeats):
        start = time.process_time()
        run()
        spent.append(time.process_time() - start)
    return statistics.median(spent) * 1e3


def memory_gib() -> float:
    """Return the peak resident memory of this process so far."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20


def measure(size: Size, threads: int, repeats: int) -> str:
    """Return one row of the table."""
    torch.set_num_threads(threads)
    torch.manual_seed(0)
    panorama = Equirectangular(*size.erp_size, 45.0, -45.0)
    depth = GivenRanges(panorama)
    model = Omni(size.grid, depth, 16, [1, 2, 2], size.channels, 0.3, None, [0, 1, 2], [8.5, 17.0])  # type: ignore[arg-type]
    before = memory_gib()
    range_m = torch.rand(size.batch, panorama.height, panorama.width) * 30 + 1
    valid = torch.rand(range_m.shape) < 0.8
    voxels = (torch.rand(size.batch, *size.grid.shape) < 0.15).to(torch.uint8)

    @torch.no_grad()
    def infer() -> None:
        model.candidates(model.logits(range_m, valid))

    def learn() -> None:
        sum(model.weighted_losses(range_m, valid, voxels).values(), torch.zeros(())).backward()

    with FlopCounterMode(display=False) as flops:
        infer()
    inference_ms, inference_gib = median_ms(infer, repeats), memory_gib()
    training_ms = median_ms(learn, repeats)
    parameters = sum(parameter.numel() for parameter in model.parameters())
    return (
        f"{size.name:13} {size.batch:5} {'/'.join(map(str, size.channels)):13} {parameters:10,} "
        f"{flops.get_total_flops() / 1e9:7.2f} {inference_ms:9.0f} {training_ms:10.0f} "
        f"{before:7.2f} {inference_gib:9.2f} {memory_gib():8.2f}"
    )


def main(threads: int = 1, repeats: int = 5) -> None:
    """Print the table."""
    print(f"{threads} thread(s), median of {repeats}")
    print(f"{'':13} {'':5} {'':13} {'':>10} {'':>7} {'ms':>9} {'ms':>10} {'GiB':>7} {'GiB':>9} {'GiB':>8}")
    print(f"{'preset':13} {'batch':5} {'channels':13} {'parameters':>10} {'GFLOP':>7} ", end="")
    print(f"{'inference':>9} {'+ training':>10} {'before':>7} {'inference':>9} {'training':>8}")
    with multiprocessing.get_context("spawn").Pool(1, maxtasksperchild=1) as pool:
        for size in SIZES:
            print(pool.apply(measure, (size, threads, repeats)), flush=True)


if __name__ == "__main__":
    main(*(int(value) for value in sys.argv[1:]))
