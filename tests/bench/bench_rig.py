"""Cost of a rig never seen before: `python tests/bench/bench_rig.py [tiny,paper] [--repeats 3]`.

For every option of the depth and lifter slots: milliseconds of a forward pass without gradient with a rig whose results
are cached, how much longer it takes with a new one, and MiB that the new rig leaves in `RIG_CACHE`; beside them the MiB
after a backward pass, which needs the transposes of the sampling matrices, and the number of rigs that fit into the
limit then. One sample, one CPU thread, CPU time, best of the repeats.
"""

import argparse
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import count
from pathlib import Path

import torch
from hydra import compose, initialize_config_dir

from omniocc.camera import Rig
from omniocc.config import build
from omniocc.model.ops.rig_cache import LIMIT_BYTES, RIG_CACHE
from omniocc.model.sketch import Sketched

CONF = Path(__file__).parents[2] / "conf"
DEPTH, LIFTER = ("omnimvs", "omnimvs3d", "sweep", "mono"), ("coloring", "coarse_coloring", "pillar", "lift_splat")
MIB = 2**20


def new_rigs(rig: Rig) -> Iterator[Rig]:
    """Yield rigs whose cameras are raised by a millimetre more each time."""
    for step in count(1):
        pose = rig.ego_from_camera.clone()
        pose[:, 2, 3] += 1e-3 * step
        yield replace(rig, ego_from_camera=pose)


def seconds(run: Callable[[], object]) -> float:
    """Return the CPU time of one call."""
    start = time.process_time()
    run()
    return time.process_time() - start


def measure(name: str, forward: Callable[[Rig], torch.Tensor], rig: Rig, repeats: int) -> None:
    """Print the row of an option."""
    RIG_CACHE.clear()
    rigs = new_rigs(rig)
    with torch.no_grad():
        forward(rig)
        known_s = min(seconds(lambda: forward(rig)) for _ in range(repeats))
        new_s = min(seconds(lambda: forward(next(rigs))) for _ in range(repeats))
        RIG_CACHE.clear()
        forward(rig)
    forward_mib = RIG_CACHE.size_bytes() / MIB
    forward(rig).square().sum().backward()
    trained_mib = RIG_CACHE.size_bytes() / MIB
    fitting = LIMIT_BYTES / MIB / trained_mib
    columns = (
        f"{known_s * 1e3:9.0f} {(new_s - known_s) * 1e3:9.0f} {forward_mib:9.1f} {trained_mib:9.1f} {fitting:9.1f}"
    )
    print(f"{name:16} {columns}", flush=True)


def main() -> None:
    """Print a table for each preset."""
    parser = argparse.ArgumentParser(description="Cost of a rig never seen before.")
    parser.add_argument("presets", nargs="?", default="tiny", help="names of presets, with commas between")
    parser.add_argument("--repeats", default=3, type=int)
    chosen = parser.parse_args()
    torch.set_num_threads(1)
    for preset in chosen.presets.split(","):
        print(f"preset={preset}, one thread, best of {chosen.repeats}, limit {LIMIT_BYTES / MIB:.0f} MiB")
        print(f"{'option':16} {'known ms':>9} {'new + ms':>9} {'MiB':>9} {'trained':>9} {'rigs':>9}", flush=True)
        for slot, options in (("depth", DEPTH), ("lifter", LIFTER)):
            for option in options:
                overrides = [f"preset={preset}", f"model/{slot}={option}", "model.backbone.weights=null"]
                with initialize_config_dir(str(CONF), version_base="1.3"):
                    cfg = compose("train", overrides)
                torch.manual_seed(0)
                width, height = cfg.preset.data.virtual.image_size
                rig = Rig.load("fisheye6").resized(width, height)
                make = depth_forward if slot == "depth" else lifter_forward
                measure(option, make(cfg), rig, chosen.repeats)


def depth_forward(cfg) -> Callable[[Rig], torch.Tensor]:
    """Return a pass of the depth option that gives something with a gradient."""
    width, height = cfg.preset.data.virtual.image_size
    model, images = build(cfg.depth).eval(), torch.rand(1, 6, 3, height, width, requires_grad=True)
    return lambda rig: model(images, (rig,)).range_m + 0 * images.sum()


def lifter_forward(cfg) -> Callable[[Rig], torch.Tensor]:
    """Return a pass of the lifter on random features with a quarter of the voxels as candidates."""
    width, height = cfg.preset.data.virtual.image_size
    geometry, lifter = build(cfg.model.geometry), build(cfg.model.lifter)
    sizes = [(-(-height // stride), -(-width // stride)) for stride in cfg.model.backbone.levels]
    features = [torch.rand(1, 6, cfg.preset.channels, *size) for size in sizes]
    sketched = Sketched(torch.rand(1, *geometry.shape) < 0.25)
    return lambda rig: lifter(features, sketched, (rig,))


if __name__ == "__main__":
    main()
