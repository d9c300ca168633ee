"""Sound files from which hostile ones are made, and the summary of all openings."""

import json
import os
import shutil
import sys
from pathlib import Path

import pytest
import torch
from filelock import FileLock

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE.parent / "record")]  # the modules beside; log_files

COUNTED: dict[str, list[int]] = {}
"""Files, openings and files with a fault of every kind, in the process that reports."""


@pytest.fixture(scope="session")
def base(shared_folder, smoke, spec) -> Path:
    """Return the folder of sound files, which is made once: scenes, a checkpoint, a rig, images of a frame."""
    from made_scenes import SCENES, write_scene

    from omniocc.config import plain
    from omniocc.predict.export_scene import export_scene
    from omniocc.run.checkpoint import CONFIG, STAGE
    from omniocc.task.build import build_task

    folder = shared_folder / "hostile-base"
    with FileLock(f"{folder}.lock"):
        if folder.exists():
            return folder
        making = folder.with_suffix(".partial")
        for number, name in enumerate(SCENES):
            write_scene(making / "scenes" / name, spec, 10 * number)
        export_scene(making / "scenes" / SCENES[0], making / "sequence")
        frame = next(path for path in sorted((making / "sequence").iterdir()) if path.is_dir())
        shutil.copytree(frame, making / "frame")
        for path in (making / "sequence").glob("rig*"):
            shutil.copy(path, making)
        cfg = smoke("data=recorded", f"data.source.root={folder / 'scenes'}", f"data.source.cache={folder / 'cache'}")
        cfg.data.source.splits = {"train": [SCENES[0]], "val": [], "test": [SCENES[1]]}
        torch.manual_seed(3)
        task = build_task(cfg, spec)
        torch.nn.init.normal_(task.model.classifier.linear.weight)
        (making / "run").mkdir()
        content = {STAGE: "occupancy", CONFIG: plain(cfg), "state_dict": task.state_dict()}
        torch.save(content, making / "run" / "best.ckpt")
        making.rename(folder)
    return folder


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """Count the files and openings of a test that has ended, in whichever process."""
    for name, value in report.user_properties:
        if name == "hostile" and report.when == "call":
            kind, openings = json.loads(str(value))
            counts = COUNTED.setdefault(kind, [0, 0, 0])
            counts[0] += 1
            counts[1] += openings
            counts[2] += report.failed


def pytest_unconfigure(config: pytest.Config) -> None:
    """Print how much was opened, after everything else."""
    if not COUNTED or os.environ.get("PYTEST_XDIST_WORKER"):
        return
    files = ", ".join(f"{counts[0]} {kind}" for kind, counts in COUNTED.items())
    openings = sum(counts[1] for counts in COUNTED.values())
    faults = ", ".join(f"{counts[2]} {kind}" for kind, counts in COUNTED.items() if counts[2])
    found = f"FAULTS in {faults}" if faults else "no code run, no file outside, no traceback, no hang, no wrong value"
    print(f"\nhostile: {files}, {openings:,} openings: {found}")
