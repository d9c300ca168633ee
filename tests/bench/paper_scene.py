"""One scene of the paper's length at the paper's size, from nothing to read samples, with time and memory of each step.

    python tests/bench/paper_scene.py out [preset=paper frames=1800]

Renders 1,800 frames, votes for the voxels and counts classes on the way, then does what a second run does before its
first step, and reads every training sample of the occupancy stage once. Each step is a command of its own, whose
processes are measured together; steps that are done are skipped (`out/steps.json`), so an interrupted measurement goes
on. The last column is what 32 such scenes, the 57,600 frames of the paper's dataset, would take in the same way.
"""

import argparse
import json
import os
import subprocess
import sys
import time
from pathlib import Path

from bench_model import CONF
from hydra import compose, initialize_config_dir

from omniocc.config import build
from omniocc.data import Needs, OccupancyData
from omniocc.io import atomic_write

SCENES = 32
STEPS = ("render", "vote and count", "second run: before the first step", "read every sample once")


def data_of(preset: str, folder: Path, frames: int) -> OccupancyData:
    """Return the data of one training scene."""
    scenes = ["data.source.train_scenes=1", "data.source.val_scenes=0", "data.source.test_scenes=0"]
    sizes = [f"data.source.frames_per_scene={frames}", "data.batch_size=1", "data.num_workers=2"]
    with initialize_config_dir(str(CONF), version_base="1.3"):
        cfg = compose("train", overrides=[f"preset={preset}", *scenes, *sizes, f"paths.data={folder}"])
    return build(cfg.data)


def take(step: str, data: OccupancyData) -> None:
    """Do one step; those before it have been done."""
    data.source.prepare()
    if step == STEPS[0]:
        return
    data.prepare_data()
    data.set_needs(Needs(pixel_labels=False, scores=False), Needs())
    data.setup()
    data.voxel_counts()
    if step == STEPS[3]:
        for count, _ in enumerate(data.train_dataloader(), 1):
            if count % 100 == 0:
                print(f"{count} samples", flush=True)


def used(folder: Path) -> int:
    """Return the bytes of all files in a folder."""
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())


def measure(step: str, chosen: argparse.Namespace) -> dict[str, float]:
    """Return seconds, processor seconds and peak memory of all processes of a step, and the bytes it wrote."""
    disk, start = used(chosen.out), time.monotonic()
    command = [sys.executable, __file__, str(chosen.out), chosen.preset, str(chosen.frames), "--step", step]
    seconds: dict[int, float] = {}
    peak_mib = 0.0
    with subprocess.Popen(command, start_new_session=True) as process:
        while process.poll() is None:
            memory_mib = 0.0
            for pid, (cpu_s, mib) in session(process.pid).items():
                seconds[pid] = max(cpu_s, seconds.get(pid, 0.0))
                memory_mib += mib
            peak_mib = max(peak_mib, memory_mib)
            time.sleep(0.25)
    if process.returncode:
        raise subprocess.CalledProcessError(process.returncode, command)
    return {
        "wall_s": time.monotonic() - start,
        "cpu_s": sum(seconds.values()),
        "peak_mib": peak_mib,
        "disk_mib": (used(chosen.out) - disk) / 2**20,
    }


def session(leader: int) -> dict[int, tuple[float, float]]:
    """Return processor seconds and memory, MiB, of every process of a session, from Linux's /proc.

    Memory is what a process has alone and its part of what it shares with others.
    """
    found = {}
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            fields = (folder / "stat").read_text().rpartition(")")[2].split()
            if int(fields[3]) != leader:
                continue
            ticks = int(fields[11]) + int(fields[12])
            rollup = (folder / "smaps_rollup").read_text()
        except OSError:  # it has ended
            continue
        kib = sum(int(line.split()[1]) for line in rollup.splitlines() if line.startswith("Pss:"))
        found[int(folder.name)] = ticks / os.sysconf("SC_CLK_TCK"), kib / 1024
    return found


def table(done: dict[str, dict[str, float]], frames: int) -> str:
    """Return the figures as a Markdown table."""
    lines = [
        "| step | time | CPU-s a frame | peak memory, MiB | disk, MiB a frame | CPU-h for 57,600 frames |",
        "|---|---:|---:|---:|---:|---:|",
    ]
    for step, row in done.items():
        once = step == STEPS[2]
        whole = row["cpu_s"] / 3600 * (1 if once else SCENES * 1800 / frames)
        cells = [f"{row['wall_s'] / 60:.1f} min", f"{row['cpu_s'] / frames:.3f}", f"{row['peak_mib']:.0f}"]
        lines.append(f"| {step} | " + " | ".join([*cells, f"{row['disk_mib'] / frames:.2f}", f"{whole:.2f}"]) + " |")
    return "\n".join(lines)


def main() -> None:
    """Measure the steps that are left and print the table; with `--step` take that one in this process."""
    parser = argparse.ArgumentParser(description="Time and memory of one scene of the paper's length and size.")
    parser.add_argument("out", type=Path)
    parser.add_argument("preset", nargs="?", default="paper")
    parser.add_argument("frames", nargs="?", type=int, default=1800)
    parser.add_argument("--step", choices=STEPS)
    chosen = parser.parse_args()
    chosen.out.mkdir(parents=True, exist_ok=True)
    if chosen.step:
        take(chosen.step, data_of(chosen.preset, chosen.out, chosen.frames))
        return
    path = chosen.out / "steps.json"
    done = json.loads(path.read_text()) if path.exists() else {}
    for step in STEPS:
        if step not in done:
            done[step] = measure(step, chosen)
            atomic_write(path, json.dumps(done, indent=1))
            print(f"{step}: {done[step]}", flush=True)
    print(f"{chosen.frames} frames of preset={chosen.preset}, {os.cpu_count()} cores\n\n{table(done, chosen.frames)}")


if __name__ == "__main__":
    main()
