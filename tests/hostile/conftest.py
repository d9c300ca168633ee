"""Sound files from which hostile ones are made, and the summary of all openings."""

import json
import os
import shutil
import sys
from pathlib import Path

import pytest
from filelock import FileLock
from scripts import run_script

HERE = Path(__file__).parent
sys.path[:0] = [
    str(HERE),
    str(HERE.parent / "extras" / "recorders"),
    str(HERE.parent / "report"),
]  # the modules beside; log_files; fake_sweep

COUNTED: dict[str, list[int]] = {}
"""Files, openings and files with a fault of every kind, in the process that reports."""


@pytest.fixture(scope="session")
def base(shared_folder, smoke, spec) -> Path:
    """Return the folder of sound files, which is made once: scenes, a checkpoint, a rig, images of a frame."""
    from fake_sweep import write_sweep
    from forge_datasets import write_all
    from made_scenes import SCENES, write_checkpoint, write_scene

    from omniocc.predict.export_scene import export_scene

    folder = shared_folder / "hostile-base"
    with FileLock(f"{folder}.lock"):
        if (folder / "ready").exists():
            return folder
        for number, name in enumerate((*SCENES, "test-002-far")):
            write_scene(folder / "scenes" / name, spec, 10 * number)
        export_scene(folder / "scenes" / SCENES[0], folder / "sequence")
        shutil.copytree(folder / "sequence" / "000000", folder / "frame")
        for path in (folder / "sequence").glob("rig*"):
            shutil.copy(path, folder)
        cfg = smoke("data=recorded", f"data.source.root={folder / 'scenes'}", f"data.source.cache={folder / 'cache'}")
        cfg.data.source.splits = {"train": [SCENES[0]], "val": [], "test": [SCENES[1]]}
        write_checkpoint(folder / "run" / "best.ckpt", cfg, spec)
        write_logs(folder)
        write_sound_bag(folder)
        write_all(folder / "datasets")
        for path in write_sweep(folder).glob("*/config.yaml"):
            path.write_text(path.read_text() + "depth: {_target_: omniocc.model.depth.OmniMVS}\n")
        run = ("predict.py", "occupancy", f"checkpoint={folder / 'run' / 'best.ckpt'}", f"rig={folder / 'rig.yaml'}")
        sequence = f"images={folder / 'sequence'}", f"poses={folder / 'sequence' / 'poses.csv'}"
        succeed(*run, *sequence, f"output={folder / 'answer'}", "overview=false", "mesh=false")
        (folder / "ready").touch()
    return folder


def succeed(*command: str) -> None:
    """Run a command on sound files."""
    done = run_script(*command)
    assert done.returncode == 0, done.stderr


def write_logs(folder: Path) -> None:
    """Write a log of three frames and one of the first alone, and the scenes that are recorded from them."""
    from log_files import lidar_option, write_log
    from made_scenes import SCENES

    from omniocc.data import SceneReader

    for name in ("log", "short"):
        (folder / name).mkdir()
        write_log(SceneReader(folder / "scenes" / SCENES[0]), folder / name)
    kept = sorted((folder / "short" / "npz").iterdir())[0].stem[:-7]  # images are some milliseconds late
    for path in folder.glob("short/*/*"):
        if not path.stem.startswith(kept):
            path.unlink()
    for name, place, more in (("log", "recorded", ()), ("short", "recorded-cloud", (lidar_option("npz"),))):
        options = [f"recorder.{option}" for option in more]
        record = ("recorder=files", f"recorder.log={folder / name}", "recorder.name=test-000-log", *options)
        size = ("recorder.road_z_m=-2.0", "recorder.panorama=[48,12,45.0,-45.0]")
        succeed("record.py", *record, *size, f"output={folder / place}")


def write_sound_bag(folder: Path) -> None:
    """Write a bag, and the scene that is recorded from it."""
    from bag_files import write_bag
    from forge_bags import SCENE, record_bag

    from omniocc.data import SceneReader

    bag = write_bag(SceneReader(folder / "scenes" / SCENE), folder / "log.bag", 1)
    succeed(*record_bag(folder, bag, folder / "recorded-bag"))


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
