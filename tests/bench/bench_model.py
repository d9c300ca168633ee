"""CPU time and peak memory of every slot: `python tests/bench/bench_model.py [preset] [threads] [repeats]`.

Each row runs forward alone, then forward and backward; the best wall-clock time of the repeats counts. The last row is
a training step but for the loss. Peak memory is that of the process so far: a row that adds none leaves it as it was.
"""

import resource
import sys
import time
from collections.abc import Callable
from pathlib import Path

import torch
from hydra import compose, initialize_config_dir
from torch import Tensor

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "src"))

from omniocc.camera import Rig  # noqa: E402
from omniocc.config import build  # noqa: E402


def timed(run: Callable[[], object], repeats: int) -> float:
    """Best of some runs, s."""
    best = float("inf")
    for _ in range(repeats):
        start = time.perf_counter()
        run()
        best = min(best, time.perf_counter() - start)
    return best


def peak_gib() -> float:
    """Peak resident memory of this process so far."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20


def total(output: object) -> Tensor:
    """A scalar to call backward on."""
    if isinstance(output, Tensor):
        return output.square().mean()
    return sum((total(part) for part in output if part is not None), torch.zeros(()))  # type: ignore[attr-defined]


def rows(preset: str) -> list[tuple[str, Callable[[], object]]]:
    """Each slot on inputs made by the slots before it, and the whole model."""
    with initialize_config_dir(str(ROOT / "conf"), version_base="1.3"):
        cfg = compose("train", overrides=[f"preset={preset}", "model.backbone.weights=null"])
    torch.manual_seed(0)
    model = build(cfg.model)
    width, height = cfg.preset.image_size
    batch = cfg.preset.train.batch_size
    rigs = (Rig.load("fisheye6").resized(width, height),) * batch
    images = torch.randint(0, 256, (batch, 1, 6, 3, height, width), dtype=torch.uint8)
    poses = torch.eye(4, dtype=torch.float64).expand(batch, 1, 4, 4)
    newest = images[:, 0].float() / 255
    with torch.no_grad():
        features = [level.requires_grad_() for level in model.backbone(newest)]
        candidates = model.sketch(newest, rigs)
        volume = model.lifter(features, candidates, rigs).requires_grad_()
        refined = model.refiner(volume).requires_grad_()
    for slot in ("backbone", "sketch", "lifter", "refiner", "semantic_head", "classifier"):
        count = sum(parameter.numel() for parameter in getattr(model, slot).parameters())
        print(f"{slot:14} {type(getattr(model, slot)).__name__:10} {count:>10,} parameters")
    return [
        ("backbone", lambda: model.backbone(newest)),
        ("lifter", lambda: model.lifter(features, candidates, rigs)),
        ("refiner", lambda: model.refiner(volume)),
        ("semantic_head", lambda: model.semantic_head(features)),
        ("classifier", lambda: model.classifier(refined)),
        ("whole model", lambda: model(images, rigs, poses)),
    ]


def main(preset: str = "tiny", threads: int = 1, repeats: int = 5) -> None:
    """Prints the table."""
    torch.set_num_threads(threads)
    print(f"preset={preset}, {threads} thread(s), best of {repeats}")
    parts = rows(preset)
    print(f"\n{'slot':14} {'forward ms':>11} {'+ backward ms':>14} {'peak GiB':>9}")
    for name, run in parts:
        with torch.no_grad():
            forward = timed(run, repeats)
        both = timed(lambda run=run: total(run()).backward(), repeats)
        print(f"{name:14} {forward * 1e3:11.0f} {both * 1e3:14.0f} {peak_gib():9.2f}", flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:2], *(int(value) for value in sys.argv[2:]))
