"""What public datasets cost: `python tests/bench/bench_datasets.py [scenes]`.

Made-up scenes in the layout of Occ3D-nuScenes: time of the index for each key frame, and processor time of everything
that a sample asks for, on one thread. nuScenes has 34,149 key frames in tables of about ten records for each sensor of
them; the scenes here have two, so the time of the index is stated per MiB of tables as well.
"""

import argparse
import sys
import tempfile
import time
from pathlib import Path

import torch
from bench_feed import seconds

from omniocc.data.source.occ3d_nuscenes import GRID, Occ3DNuScenes
from omniocc.geometry import Cylinder, Grid, resample

sys.path.append(str(Path(__file__).parents[1] / "data" / "formats"))
from nuscenes_files import write_nuscenes

PANORAMA = (360, 90, 45.0, -45.0)
GRIDS: dict[str, Grid] = {
    "cylinder 64x100x16, 40 m": Cylinder((64, 100, 16), (0.0, 40.0)),
    "cylinder 200x200x16, 40 m": Cylinder((200, 200, 16), (0.0, 40.0)),
    "its own": GRID,
}


def report(folder: Path, scenes: int) -> None:
    """Print the times."""
    names = tuple(f"scene-{1000 + k:04d}" for k in range(scenes - 1))
    root = write_nuscenes(folder, (*names, "scene-0003"), frames=10)
    source = Occ3DNuScenes(str(root), "v1.0-trainval", 704, PANORAMA, True, 2, None)
    begin = time.perf_counter()
    source.prepare()
    index_s = time.perf_counter() - begin
    mib = sum(file.stat().st_size for file in (root / "v1.0-trainval").iterdir()) / 2**20
    frame_ms, mib_ms = 1e3 * index_s / (10 * scenes), 1e3 * index_s / mib
    print(f"{'index':40} {frame_ms:8.2f} ms a key frame, {mib_ms:.1f} ms a MiB of tables")
    scene = source.scenes("test")[0]
    labels = scene.own_voxels(0, "none")
    parts = {
        "six images of 160x90 px": lambda: scene.images(0),
        "labels": lambda: scene.own_voxels(0, "none"),
        "labels, mask, origins": lambda: scene.benchmark(0),
        "ranges of six cameras": lambda: scene.camera_range_m(0),
        "panorama": lambda: scene.erp_range_m(0),
        "labels, unobserved cells unknown": lambda: scene.own_voxels(0, "unobserved"),
        **{f"labels to {name}": lambda grid=grid: resample(labels, GRID, grid) for name, grid in GRIDS.items()},
    }
    for name, run in parts.items():
        run()
        print(f"{name:40} {1e3 * seconds(run):8.1f} ms")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scenes", nargs="?", type=int, default=20, help="to write")
    torch.set_num_threads(1)
    with tempfile.TemporaryDirectory() as temporary:
        report(Path(temporary), parser.parse_args().scenes)
