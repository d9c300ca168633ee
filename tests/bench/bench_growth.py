"""How cost grows with the work: `python tests/bench/bench_growth.py [--repeats 3]`.

Each row does a piece of work and four times as much of it. The exponent is log4 of the ratio of both times: 1 if time
is proportional to the work, 2 if it is to its square, 0 if it does not depend on it. One CPU thread, CPU time, best of
the repeats; memory is the peak above what was held before. A run before leaves out what only the first one does, such
as imports and tables of a grid or rig. On two busy cores the exponents were 0.2 for runs of a report, since its page
costs more than 20 runs, and 1.04 for rigs. Opening scenes takes milliseconds; its exponent varied from 0.9 to 1.24.
"""

import argparse
import contextlib
import io
import math
import os
import sys
import tempfile
from collections.abc import Callable, Iterator
from itertools import islice
from pathlib import Path

import torch
from bench_model import CONF, Meter
from bench_rig import new_rigs
from hydra import compose, initialize_config_dir

from omniocc.camera import Rig
from omniocc.config import build
from omniocc.data.source.recorded import Recorded
from omniocc.model.sketch import Sketched
from omniocc.predict.predictor import Input, Predictor

sys.path.append(str(Path(__file__).parents[1] / "report"))
sys.path.append(str(Path(__file__).parents[1] / "data"))
sys.path.append(str(Path(__file__).parents[1] / "extras" / "viewer"))

from fake_scene import FakeWorld
from fake_sweep import CYLINDER, OMNI, report, write_run
from made_scenes import write_scene

Work = Callable[[int], Callable[[], object]]
"""Returns what does a piece of work, or four times as much."""


def works(folder: Path) -> Iterator[tuple[str, str, Work]]:
    """Yield the name of each quantity, what is run, and the work."""
    with initialize_config_dir(str(CONF), version_base="1.3"):
        cfg = compose("train", ["preset=tiny", "model.backbone.weights=null"])
    width, height = cfg.preset.data.virtual.image_size
    rig, depth = Rig.load("fisheye6").resized(width, height), build(cfg.depth).eval()
    features = [
        torch.rand(1, 6, cfg.preset.channels, -(-height // s), -(-width // s)) for s in cfg.model.backbone.levels
    ]

    def lift(shape: tuple[int, ...], fraction: float) -> Callable[[], object]:
        geometry = build(cfg.model.geometry, shape=list(shape))
        lifter, chosen = build(cfg.model.lifter, geometry=geometry), Sketched(torch.rand(1, *shape) < fraction)
        return lambda: lifter(features, chosen, (rig,))

    def ranges(rigs: list[Rig]) -> Callable[[], object]:
        size = rigs[0].cameras[0].height, rigs[0].cameras[0].width
        images = torch.rand(1, len(rigs[0].cameras), 3, *size)
        return lambda: [depth(images, (one,)) for one in rigs]

    def more_cameras(times: int) -> Rig:
        names = tuple(f"{name}{k}" for k in range(times) for name in rig.names)
        return Rig(rig.cameras * times, rig.ego_from_camera.repeat(times, 1, 1), names)

    unseen = new_rigs(rig)
    side = {1: 1, 4: 2}
    yield "voxels of the grid", "lifter", lambda times: lift((32 * side[times], 50 * side[times], 8), 0.25)
    yield "candidates", "lifter", lambda times: lift((64, 100, 8), 0.2 * times)
    yield "cameras", "depth network", lambda times: ranges([more_cameras(times)])
    yield (
        "pixels of the images",
        "depth network",
        lambda times: ranges([rig.resized(width * side[times], height * side[times])]),
    )
    yield "rigs never seen before", "depth network", lambda times: lambda: ranges(list(islice(unseen, 2 * times)))()
    model = build(cfg.model).eval()

    def drive(times: int) -> Callable[[], object]:
        given = Input(torch.rand(1, 6, 3, height, width), rig, torch.eye(4, dtype=torch.float64))
        predictor = Predictor(model, None, (), torch.device("cpu"))
        return lambda: sum(1 for _ in predictor.frames(range(3 * times), "stream", lambda frame: given))

    yield "frames of a sequence", "predictor", drive
    write_scene(folder / "scene", FakeWorld(str(folder / "data")).spec)

    def opened(times: int) -> Callable[[], object]:
        root = folder / f"scenes-{times}"
        root.mkdir()
        for k in range(50 * times):
            os.symlink(folder / "scene", root / f"test-{k:03d}")
        splits = {"train": ["test-*0"], "val": ["test-*1"], "test": ["test-*[2-9]"]}
        return lambda: len(Recorded(str(root), splits=splits).scenes("test"))

    yield "scenes of a dataset", "opening it", opened

    def reported(times: int) -> Callable[[], object]:
        world, runs = FakeWorld(str(folder / "data")), folder / f"runs-{times}"
        for k in range(20 * times):
            write_run(runs / f"ours-{k:08x}", k, 0.3, world, OMNI, CYLINDER)
        return lambda: report("--runs", str(runs), "--output", str(folder / f"report-{times}"))

    yield "runs of a report", "report.py", reported


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", default=3, type=int)
    parser.add_argument("--only", default="", help="beginning of the quantities to measure")
    chosen = parser.parse_args()
    torch.set_num_threads(1)
    meter = Meter(torch.device("cpu"), 1, chosen.repeats)
    print(f"{'four times as many':26} {'in':14} {'ms':>9} {'ms x4':>9} {'exponent':>9} {'MiB':>7} {'MiB x4':>7}")
    with tempfile.TemporaryDirectory() as temporary, torch.no_grad():
        for name, what, work in works(Path(temporary)):
            if not name.startswith(chosen.only):
                continue
            measured = []
            for times in (1, 4):
                run = work(times)
                with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
                    run()
                    measured.append(meter.measure(run))
            (once_ms, once_mib), (often_ms, often_mib) = measured
            exponent = math.log(often_ms / once_ms, 4)
            print(
                f"{name:26} {what:14} {once_ms:9.1f} {often_ms:9.1f} {exponent:9.2f} {once_mib:7.0f} {often_mib:7.0f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
