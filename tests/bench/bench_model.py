"""What every slot costs: `python tests/bench/bench_model.py [tiny,paper] [--device cuda] [--threads 2] [key=value]`.

Three tables and a profile for each preset. Slots: parameters, billions of floating-point operations forward (a
multiplication and an addition are two), time forward and of forward and backward, peak memory above what was held
before. The three operators that cost most in a training step. Options beside the chosen ones. The lifter by fraction of
candidates.

Times are the best of the repeats: on one CPU thread its CPU time, which other processes disturb least, otherwise wall
time. Memory of a CPU is what the process held at its peak (Linux with glibc; elsewhere NaN).
"""

import argparse
import ctypes
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch
from hydra import compose, initialize_config_dir
from omegaconf import DictConfig
from torch import Tensor, nn
from torch.profiler import profile

from omniocc.camera import Rig
from omniocc.config import build
from omniocc.model.sketch import Random, Sketched
from omniocc.runs.cost import count_gflop
from omniocc.runs.machine import keep_freed_memory

CONF = Path(__file__).parents[2] / "conf"
STATUS, CLEAR_REFS = Path("/proc/self/status"), Path("/proc/self/clear_refs")
FRACTIONS = (0.1, 0.25, 0.5, 1.0)
Run = Callable[[], object]


class Meter:
    """Measure on one device."""

    def __init__(self, device: torch.device, threads: int, repeats: int):
        self.device, self.repeats = device, repeats
        self.clock = time.process_time if device.type == "cpu" and threads == 1 else time.perf_counter

    def measure(self, run: Run) -> tuple[float, float]:
        """Return milliseconds, best of the repeats, and the most MiB held at a time, above what was held before.

        NaN where the system does not tell how much memory is held.
        """
        before = self._forget_peak()
        best = min(self._seconds(run) for _ in range(self.repeats))
        return best * 1e3, max(self._peak() - before, 0) / 2**20

    def _seconds(self, run: Run) -> float:
        self._wait()
        start = self.clock()
        run()
        self._wait()
        return self.clock() - start

    def _forget_peak(self) -> float:
        """Return the bytes held now."""
        if self.device.type == "cuda":
            torch.cuda.reset_peak_memory_stats()
            return torch.cuda.memory_allocated()
        if not CLEAR_REFS.exists() or not hasattr(ctypes.CDLL(None), "malloc_trim"):
            return float("nan")
        ctypes.CDLL(None).malloc_trim(0)  # free memory that is kept would hide memory that is used
        CLEAR_REFS.write_text("5", encoding="utf-8")
        return status_bytes("VmRSS")

    def _peak(self) -> float:
        if self.device.type == "cuda":
            return torch.cuda.max_memory_allocated()
        return status_bytes("VmHWM") if STATUS.exists() else float("nan")

    def _wait(self) -> None:
        if self.device.type == "cuda":
            torch.cuda.synchronize()


def status_bytes(key: str) -> int:
    """Return an entry of this process' status."""
    return (
        next(int(line.split()[1]) for line in STATUS.read_text(encoding="utf-8").splitlines() if line.startswith(key))
        * 1024
    )


def total(output: object) -> Tensor:
    """Return a scalar to call backward on."""
    if isinstance(output, Tensor):
        return output.float().square().mean()
    parts = [part for part in output if isinstance(part, Tensor | tuple | list)]  # type: ignore[attr-defined]
    return sum((total(part) for part in parts), torch.zeros(()))


def count(module: object) -> int:
    """Return the number of parameters."""
    return sum(parameter.numel() for parameter in module.parameters()) if isinstance(module, nn.Module) else 0


def row(meter: Meter, name: str, module: object, run: Run, trains: bool = True) -> None:
    """Measure and print one line."""

    def step() -> None:
        total(run()).backward()

    cost = count_gflop(run)  # first: it fills the caches of rigs and grids
    with torch.no_grad():
        forward, memory = meter.measure(run)
    both, held = meter.measure(step) if trains else (float("nan"), float("nan"))
    figures = f"{cost:9.2f} {forward:9.0f} {both:9.0f} {memory:9.0f} {held:9.0f}"
    print(f"{name:28} {count(module) / 1e6:8.3f} {figures}", flush=True)


def header(title: str) -> None:
    """Print the first line of a table."""
    columns = ("M param", "GFLOP fw", "ms fw", "ms fw+bw", "MiB fw", "MiB fw+bw")
    print(f"\n{title:28} {columns[0]:>8} " + " ".join(f"{column:>9}" for column in columns[1:]))


class Inputs:
    """Inputs of every slot, from the slots before it."""

    def __init__(self, cfg: DictConfig, model: nn.Module, device: torch.device):
        width, height = cfg.preset.data.virtual.image_size
        self.batch = cfg.preset.stages.occupancy.batch_size
        frames = cfg.preset.temporal.frames
        self.rigs = (Rig.load("fisheye6").resized(width, height),) * self.batch
        self.images = torch.randint(0, 256, (self.batch, frames, 6, 3, height, width), dtype=torch.uint8, device=device)
        self.poses = torch.eye(4, dtype=torch.float64, device=device).repeat(self.batch, frames, 1, 1)
        self.poses[:, :, 0, 3] = torch.arange(frames, device=device)  # a metre a frame
        self.exists = torch.ones(self.batch, frames, dtype=torch.bool, device=device)
        self.newest = self.images[:, -1].float() / 255
        with torch.no_grad():
            self.features = [level.requires_grad_() for level in model.backbone(self.newest)]
            self.sketched = self.candidates(model.geometry, 0.25)
            volume = model.lifter(self.features, self.sketched, self.rigs)
            self.volume = volume.requires_grad_()
            self.volumes = [torch.rand_like(volume) for _ in range(frames - 1)] + [self.volume]
            self.refined = model.refiner(volume, self.sketched).requires_grad_()

    def of(self, slot: str) -> tuple[Any, ...]:
        """Return the arguments of a slot that may be exchanged."""
        window = self.volumes, self.poses, self.exists
        return {"backbone": (self.newest,), "refiner": (self.volume, self.sketched), "temporal": window}[slot]

    def candidates(self, geometry: Any, fraction: float) -> Sketched:
        """Return the same random cells for every sample, and random evidence."""
        device = self.newest.device
        chosen = Random(geometry, fraction).to(device)(self.newest, self.rigs).candidates
        return Sketched(chosen, torch.randint(0, 256, chosen.shape, dtype=torch.uint8, device=device))


SlotRun = tuple[str, object, Run, bool]


def slot_runs(model: Any, inputs: Inputs) -> list[SlotRun]:
    """Return name, module and forward pass of every slot and of the whole model, and whether it is trained."""
    frames = inputs.images.shape[1]
    window = Sketched(*(part[:, None].repeat(1, frames, 1, 1, 1) for part in inputs.sketched))
    rigs = tuple((rig,) * frames for rig in inputs.rigs)
    everything = (inputs.images, rigs, inputs.poses, window, inputs.exists)
    return [
        ("sketch and depth", model.sketch, lambda: model.sketch(inputs.newest, inputs.rigs), False),
        ("backbone", model.backbone, lambda: model.backbone(inputs.newest), True),
        ("lifter", model.lifter, lambda: model.lifter(inputs.features, inputs.sketched, inputs.rigs), True),
        ("temporal", model.temporal, lambda: model.temporal(inputs.volumes, inputs.poses, inputs.exists), True),
        ("refiner", model.refiner, lambda: model.refiner(inputs.volume, inputs.sketched), True),
        ("semantic_head", model.semantic_head, lambda: model.semantic_head(inputs.features), True),
        ("classifier", model.classifier, lambda: model.classifier(inputs.refined), True),
        ("all but the sketch", model, lambda: model(*everything), True),
    ]


def slots(meter: Meter, model: Any, inputs: Inputs) -> None:
    """Print the rows of the slots and of the whole model."""
    header("slot")
    runs = slot_runs(model, inputs)
    for name, module, run, trains in runs:
        row(meter, name, module, run, trains)
    everything = runs[-1][2]
    with profile() as profiler:
        total(everything()).backward()
    events = profiler.key_averages()
    key = "self_cpu_time_total" if meter.device.type == "cpu" else "self_device_time_total"
    whole = sum(getattr(event, key) for event in events)
    print("\nthe three largest costs of a training step")
    for event in sorted(events, key=lambda event: -getattr(event, key))[:3]:
        spent = getattr(event, key)
        print(f"{event.key:44} {spent / whole:5.0%} {spent / 1e3:8.0f} ms {event.count:6} calls")


def options(meter: Meter, cfgs: dict[str, DictConfig], inputs: Inputs, device: torch.device) -> None:
    """Print the rows of options beside those of the model."""
    header("option")
    for name, cfg in cfgs.items():
        slot = name.split("=")[0].split(".")[0].split("/")[-1]
        module = build(cfg.model[slot]).to(device)
        arguments = inputs.of(slot)
        row(meter, name, module, lambda module=module, arguments=arguments: module(*arguments))


def fractions(meter: Meter, model: Any, inputs: Inputs) -> None:
    """Print the lifter's cost by fraction of candidates."""
    header("lifter, candidates")
    for fraction in FRACTIONS:
        chosen = inputs.candidates(model.geometry, fraction)
        run = lambda chosen=chosen: model.lifter(inputs.features, chosen, inputs.rigs)  # noqa: E731
        row(meter, f"{fraction:.0%}", model.lifter, run)


def compare(preset: str, overrides: list[str], meter: Meter, threads: int) -> None:
    """Print the tables of one preset."""
    base = [
        f"preset={preset}",
        "model.backbone.weights=null",
        *overrides,
    ]
    others = {
        "model/temporal=mean": ["model/temporal=mean"],
        "model/refiner=unet": ["model/refiner=unet"],
        "model/refiner=attention": ["model/refiner=attention"],
        "backbone=stages []": ["model/backbone=resnet", "model.backbone.deformable_stages=[]"],
        "backbone=stages [3,4]": ["model/backbone=resnet", "model.backbone.deformable_stages=[3,4]"],
        "model/backbone=transformers": ["model/backbone=transformers"],
        "model/backbone=efficientnet_lite0": ["model/backbone=efficientnet_lite0"],
    }
    with initialize_config_dir(str(CONF), version_base="1.3"):
        cfg = compose("train", overrides=base)
        cfgs = {name: compose("train", [*base, *own]) for name, own in others.items()}
    model = build(cfg.model).to(meter.device)
    inputs = Inputs(cfg, model, meter.device)
    print(f"\npreset={preset} {' '.join(overrides)}, batch of {inputs.batch}, {meter.device}", end=", ")
    print(f"{threads} thread(s), best of {meter.repeats}; a quarter of the voxels are candidates")
    slots(meter, model, inputs)
    options(meter, cfgs, inputs, meter.device)
    fractions(meter, model, inputs)


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("presets", nargs="?", default="tiny", help="names of presets, with commas between")
    parser.add_argument("overrides", nargs="*")
    parser.add_argument("--device", default="cpu", type=torch.device)
    parser.add_argument("--threads", default=1, type=int)
    parser.add_argument("--repeats", default=3, type=int)
    chosen = parser.parse_args()
    torch.set_num_threads(chosen.threads)
    torch.manual_seed(0)
    keep_freed_memory()
    for preset in chosen.presets.split(","):
        compare(preset, chosen.overrides, Meter(chosen.device, chosen.threads, chosen.repeats), chosen.threads)


if __name__ == "__main__":
    main()
