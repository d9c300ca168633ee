"""What it costs to read a sample: `python tests/bench/bench_feed.py [tiny,paper]`.

Processor time on one thread of a training sample of every stage and of a test sample, from scenes rendered for this.
Samples a second and core are its inverse; a GPU that takes n samples a second needs n times the time in cores
(`data.num_workers`).
"""

import argparse
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import torch
from bench_model import CONF
from hydra import compose, initialize_config_dir

from omniocc.config import build
from omniocc.data import CandidateCache, Needs, OccupancyData, RangeCache

REPEATS = 9


def seconds(run: Callable[[], object]) -> float:
    """Return the median processor time."""
    spent = []
    for _ in range(REPEATS):
        start = time.process_time()
        run()
        spent.append(time.process_time() - start)
    return sorted(spent)[REPEATS // 2]


def fill(data: OccupancyData, folder: Path, panorama: tuple[int, int]) -> tuple[RangeCache, CandidateCache]:
    """Return caches of the first two stages with made-up content for all frames."""
    ranges, candidates = RangeCache(folder / "ranges", panorama), CandidateCache(folder / "c", data.geometry.shape)
    for scene in data.source.scenes("train"):
        chosen = torch.rand(data.geometry.shape) < 0.2
        ranges.write(scene.name, [torch.rand(panorama) * 30 for _ in range(len(scene))])
        candidates.write(scene.name, [chosen for _ in range(len(scene))])
    return ranges, candidates


def report(preset: str, folder: Path) -> None:
    """Print one block."""
    split = [f"data.source.{name}_scenes=1" for name in ("train", "val", "test")]
    overrides = [f"preset={preset}", *split, "data.source.frames_per_scene=5", f"paths.data={folder}"]
    with initialize_config_dir(str(CONF), version_base="1.3"):
        cfg = compose("train", overrides=overrides)
    data: OccupancyData = build(cfg.data)
    data.prepare_data()
    size = cfg.preset.panorama.height, cfg.preset.panorama.width
    ranges, candidates = fill(data, folder / preset, size)
    depth = Needs(voxels=False, pixel_labels=False, scores=False, panorama=True)
    stages = {
        "depth": (1, depth),
        "depth, model/depth=mono": (1, depth._replace(camera_ranges=True)),
        "sketch": (1, Needs(images=False, pixel_labels=False, scores=False, depth=ranges)),
        "occupancy": (data.window, Needs(scores=False, candidates=candidates)),
        "occupancy, test": (data.window, Needs(pixel_labels=False, candidates=candidates)),
        "everything": (data.window, Needs(True, True, True, True, True, True, ranges, candidates)),
    }
    print(f"\npreset={preset}, images of {cfg.preset.data.virtual.image_size}, windows of {data.window}")
    print(f"{'sample of':28} {'ms':>8} {'samples/s and core':>20}")
    for name, (window, needs) in stages.items():
        data.window = window
        data.set_needs(needs, needs)
        data.setup()
        dataset = data.dataset("train")
        spent = seconds(lambda dataset=dataset: dataset[len(dataset) - 1])
        print(f"{name:28} {spent * 1e3:8.1f} {1 / spent:20.1f}", flush=True)


def main() -> None:
    """Print a block for each preset."""
    parser = argparse.ArgumentParser(description="Cost of reading samples.")
    parser.add_argument("presets", nargs="?", default="tiny,paper", help="names of presets, with commas between")
    chosen = parser.parse_args()
    torch.set_num_threads(1)
    with tempfile.TemporaryDirectory() as folder:
        for preset in chosen.presets.split(","):
            report(preset, Path(folder))


if __name__ == "__main__":
    main()
