"""Cost of every depth option: `python tests/bench/bench_depth.py [tiny|paper] [options, comma-separated] [repeats]`.

`tiny` is a 192x48 panorama from six 256x144 images, `paper` the paper's 720x180 from six 1920x1080. One sample, one
thread, forward without gradients; every option runs in a process of its own, so that its peak memory is its own. The
time is the median CPU time of the repeats after a first run, which also makes the matrices of the rig ('first').
"""

import resource
import statistics
import subprocess
import sys
import time
from pathlib import Path

import torch
from hydra import compose, initialize_config_dir
from torch.utils.flop_counter import FlopCounterMode

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "src"))

from omniocc.camera import Rig  # noqa: E402
from omniocc.config import build  # noqa: E402

aten = torch.ops.aten
SIZES = {"tiny": (256, 144), "paper": (1920, 1080)}
OPTIONS = "omnimvs,omnimvs3d,sweep,mono"


def product_flops(left: torch.Tensor, right: torch.Tensor, **_: object) -> int:
    """Count a matrix product; the counter's own formula counts the zeros of sparse matrices."""
    entries = left._nnz() if left.layout == torch.sparse_csr else left.numel()
    return 2 * entries * right.shape[-1]


def sum_flops(_: torch.Tensor, left: torch.Tensor, right: torch.Tensor, **__: object) -> int:
    """Count a product that is added to something."""
    return product_flops(left, right)


product_flops._get_raw = sum_flops._get_raw = True  # type: ignore[attr-defined]


def measure(preset: str, option: str, repeats: int) -> str:
    """Return one row of the table."""
    torch.set_num_threads(1)
    with initialize_config_dir(str(ROOT / "conf"), version_base="1.3"):
        cfg = compose("train", overrides=[f"preset={preset}", f"model/depth={option}"])
    torch.manual_seed(0)
    model = build(cfg.depth).eval()
    width, height = SIZES[preset]
    rigs = (Rig.load("fisheye6").resized(width, height),)
    images = torch.rand(1, 6, 3, height, width)
    times_s = []
    with torch.inference_mode():
        for _ in range(repeats + 1):
            start = time.process_time()
            model(images, rigs)
            times_s.append(time.process_time() - start)
        peak_gib = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
        with FlopCounterMode(display=False, custom_mapping={aten.mm: product_flops, aten.addmm: sum_flops}) as counter:
            model(images, rigs)
    count = sum(parameter.numel() for parameter in model.parameters())
    flops = counter.get_total_flops() / 1e9
    median_ms = statistics.median(times_s[1:]) * 1e3
    return f"{option:10} {count:>11,} {times_s[0]:8.1f} {median_ms:9.0f} {flops:8.1f} {peak_gib:9.2f}"


def main(preset: str = "tiny", options: str = OPTIONS, repeats: str = "5") -> None:
    """Print the table; with one option, its row alone."""
    if "," not in options:
        print(measure(preset, options, int(repeats)), flush=True)
        return
    print(f"preset={preset}, one thread, median of {repeats}; GFLOPs of products and convolutions")
    print(f"{'option':10} {'parameters':>11} {'first s':>8} {'then ms':>9} {'GFLOPs':>8} {'peak GiB':>9}", flush=True)
    for option in options.split(","):
        subprocess.run([sys.executable, __file__, preset, option, repeats], check=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
