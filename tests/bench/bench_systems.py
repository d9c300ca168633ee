"""What the systems of the paper's comparison cost: `python tests/bench/bench_systems.py [tiny,paper] [--device cuda]`.

One line for each system and preset: voxels; parameters; billions of floating-point operations, milliseconds and peak
memory of a frame of a sequence (one sample, no gradient, past frames remembered); milliseconds and peak memory of a
training step with the preset's batch and all past frames, forward and backward, where asked for. The learned sketch and
its depth are left out, as their candidates are precomputed: `bench_sketch.py` and `bench_depth.py` measure those. A
tenth of the voxels are candidates where a sketch chooses them.

Times and memory are as in `bench_model.py`.
"""

import argparse

import torch
from bench_model import CONF, Meter, total
from hydra import compose, initialize_config_dir
from omegaconf import DictConfig

from omniocc.camera import Rig
from omniocc.config import build
from omniocc.model import OccupancyModel, Stream
from omniocc.model.sketch import Dense, Random
from omniocc.runs.cost import count_gflop
from omniocc.runs.machine import keep_freed_memory

SYSTEMS = {
    "ours": "default",
    "VoxFormer": "voxformer",
    "BEVFormer": "bevformer",
    "BEVDet": "bevdet",
    "FlashOcc": "flashocc",
    "FoSOcc": "fosocc",
    "OneOcc": "oneocc",
    "AdaptiveOcc": "adaptiveocc",
}
FRACTION = 0.1
COLUMNS = ("M voxels", "M param", "GFLOP", "ms/frame", "MiB", "ms/step", "MiB/step")


def make_model(cfg: DictConfig, device: torch.device) -> OccupancyModel:
    """Return the system; the candidates of a learned sketch are drawn at random instead."""
    geometry = build(cfg.model.geometry)
    dense = cfg.model.sketch._target_.endswith("Dense")
    slots = ("backbone", "lifter", "temporal", "refiner", "semantic_head", "hints")
    parts = {slot: build(cfg.model[slot]) for slot in slots}
    sketch = Dense(geometry) if dense else Random(geometry, FRACTION)
    return OccupancyModel(geometry=geometry, sketch=sketch, num_classes=cfg.model.num_classes, **parts).to(device)


class Sequence:
    """A car that moves by a metre a frame."""

    def __init__(self, cfg: DictConfig, model: OccupancyModel, device: torch.device):
        width, height = cfg.preset.data.virtual.image_size
        self.model, self.frames, self.batch = model, model.temporal.frames, cfg.preset.stages.occupancy.batch_size
        self.rig = Rig.load("fisheye6").resized(width, height)
        self.rigs = ((self.rig,) * self.frames,) * self.batch
        shape = (self.batch, self.frames, 6, 3, height, width)
        self.images = torch.randint(0, 256, shape, dtype=torch.uint8, device=device)
        self.poses = torch.eye(4, dtype=torch.float64, device=device).repeat(self.batch, self.frames, 1, 1)
        self.poses[:, :, 0, 3] = torch.arange(self.frames, device=device)
        self.stream = Stream(model)

    def frame(self) -> object:
        """Predict one more frame."""
        with torch.no_grad():
            return self.stream.step(self.images[0, -1], self.rig, self.poses[0, -1])

    def step(self) -> None:
        """Go forward and backward on a batch of windows."""
        total(self.model(self.images, self.rigs, self.poses)).backward()


def measure(name: str, cfg: DictConfig, meter: Meter, trains: bool) -> None:
    """Print one line."""
    model = make_model(cfg, meter.device)
    sequence = Sequence(cfg, model, meter.device)
    model.eval()
    for _ in range(sequence.frames - 2):  # fills the memory of past frames
        sequence.frame()
    cost = count_gflop(sequence.frame)  # before times: it fills the caches of rig and grid
    ms, mib = meter.measure(sequence.frame)
    sequence.stream.reset()
    model.train()
    step = meter.measure(sequence.step) if trains else (float("nan"), float("nan"))
    voxels, parameters = model.geometry.num_cells / 1e6, sum(p.numel() for p in model.parameters()) / 1e6
    figures = f"{voxels:9.2f} {parameters:9.2f} {cost:9.1f} {ms:9.0f} {mib:9.0f} {step[0]:9.0f} {step[1]:9.0f}"
    print(f"{name:12} {figures}", flush=True)


def main() -> None:
    """Print a table for each preset."""
    parser = argparse.ArgumentParser(description="Cost of the systems of the comparison.")
    parser.add_argument("presets", nargs="?", default="tiny,paper", help="names of presets, with commas between")
    parser.add_argument("overrides", nargs="*")
    parser.add_argument("--device", default="cpu", type=torch.device)
    parser.add_argument("--threads", default=1, type=int)
    parser.add_argument("--repeats", default=3, type=int, help="of the presets but paper, which is measured once")
    parser.add_argument("--systems", default=",".join(SYSTEMS), help="names of systems, with commas between")
    parser.add_argument("--train", default="tiny", help="presets of which a training step is measured too")
    chosen = parser.parse_args()
    torch.set_num_threads(chosen.threads)
    torch.manual_seed(0)
    keep_freed_memory()
    for preset in chosen.presets.split(","):
        repeats = 1 if preset == "paper" and chosen.device.type == "cpu" else chosen.repeats
        meter = Meter(chosen.device, chosen.threads, repeats)
        print(f"\npreset={preset} {' '.join(chosen.overrides)}, {chosen.device}", end=", ")
        print(f"{chosen.threads} thread(s), best of {repeats}")
        print(f"{'system':12} " + " ".join(f"{column:>9}" for column in COLUMNS))
        for name in chosen.systems.split(","):
            overrides = [
                f"preset={preset}",
                f"model={SYSTEMS[name]}",
                "model.backbone.weights=null",
                *chosen.overrides,
            ]
            with initialize_config_dir(str(CONF), version_base="1.3"):
                cfg = compose("train", overrides)
            measure(name, cfg, meter, trains=preset in chosen.train.split(","))


if __name__ == "__main__":
    main()
