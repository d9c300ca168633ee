"""A small page: made-up streets on both grids, two runs, three scenes, names that try to be HTML."""

import functools
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from omniocc.camera import Equirectangular, Rig
from omniocc.classes import FREE, UNKNOWN, WORLD_CLASSES
from omniocc.extras.viewer.frames import FramePrediction, Shown, ShownFrame
from omniocc.extras.viewer.page import write_page
from omniocc.geometry import Cuboid, Cylinder, Grid

HEIGHT_M, REACH_M = (-2.8, 3.6), 25.6
CYLINDER = Cylinder((32, 60, 8), (0.0, REACH_M), HEIGHT_M)
CUBOID = Cuboid((40, 40, 8), (-REACH_M, REACH_M), (-REACH_M, REACH_M), HEIGHT_M)
EVIL = "</script><script>window.hacked = 1</script><img src=x onerror='window.hacked = 2'>&amp;"
SCENES = ("test-000-oldtown", EVIL, "test-002-campus")
FRAMES_EACH = 2
RUNS = ("ours", "<b>cuboid</b>")
RAYIOU = (0.52, 0.31, 0.47, 0.28, 0.61, 0.4)
"""Of the first run, by frame: the three worst are 3, 1 and 5."""
SIZE = (256, 144)
PANORAMA = Equirectangular(90, 24, 45.0, -45.0)


@functools.cache
def rig() -> Rig:
    return Rig.load("fisheye6").resized(*SIZE)


def street(grid: Grid, seed: int, noise: float = 0.0) -> Tensor:
    """Return labels of a road with buildings, boxes and poles on it; `noise` is the fraction of cells that are changed.

    Cells outside of a circle, and some others, are unknown.
    """
    random = np.random.default_rng(seed)
    x, y, z = grid.centers(torch.float64).numpy().transpose(3, 0, 1, 2)
    labels = np.zeros(grid.shape, dtype=np.uint8)
    floor = z < -2.0
    labels[floor] = 3
    labels[floor & (np.abs(y) < 6)] = 2
    labels[floor & (np.abs(y) < 4)] = 1
    for label, count, size in ((4, 10, 5.0), (6, 6, 2.0), (7, 5, 2.0), (10, 6, 0.8), (9, 6, 0.8)):
        for _ in range(count):
            near, far = random.uniform(3, 22), random.uniform(-20, 20)
            height = random.uniform(-1, 3)
            labels[(np.abs(x - far) < size) & (np.abs(np.abs(y) - near) < size / 2) & (z < height) & ~floor] = label
    changed = random.random(grid.shape) < noise
    labels[changed] = random.integers(0, WORLD_CLASSES.num_classes, int(changed.sum()))
    if not noise:
        labels[(random.random(grid.shape) < 0.02) | (np.hypot(x, y) > 24.5)] = 255
    return torch.from_numpy(labels)


def evidence(seed: int, grid: Grid) -> Tensor:
    """Return 300 points for every occupied cell, and two LiDAR rays and one camera ray for every known one."""
    labels = street(grid, seed)
    known = labels != UNKNOWN
    return torch.stack([300 * (known & (labels != FREE)), 2 * known, 1 * known])


def images(seed: int) -> tuple[np.ndarray, ...]:
    """Return an image for each camera: gradients in other colours."""
    width, height = SIZE
    ramp = np.stack(np.meshgrid(np.linspace(0, 255, width), np.linspace(0, 255, height)), -1)
    return tuple(
        np.concatenate([ramp, np.full((height, width, 1), 40 * k + 7 * seed)], -1).astype(np.uint8)
        for k in range(len(rig().cameras))
    )


def made_frames(runs: tuple[str, ...] = RUNS) -> Iterator[ShownFrame]:
    grids = dict(zip(RUNS, (CYLINDER, CUBOID), strict=True))
    for number in range(len(SCENES) * FRAMES_EACH):
        range_m = torch.from_numpy(np.random.default_rng(number).uniform(1, 40, (24, 90)).astype(np.float32))
        predictions = {
            run: FramePrediction(
                labels=street(grids[run], number, 0.03),
                grid=grids[run],
                candidates=None,
                range_m=range_m if run == RUNS[0] else None,
                panorama=PANORAMA if run == RUNS[0] else None,
                pixel_labels=None,
                figures={"rayiou": RAYIOU[number] - 0.1 * (run != RUNS[0]), "iou": 0.5, "miou": float("nan")},
            )
            for run in runs
        }
        yield ShownFrame(
            scene=SCENES[number // FRAMES_EACH],
            frame=f"{number % FRAMES_EACH:06d}",
            time_s=0.5 * (number % FRAMES_EACH),
            images=images(number),
            rig=rig(),
            world_from_ego=None,
            truth={grid: street(grid, number) for grid in dict.fromkeys([*(grids[run] for run in runs), CYLINDER])},
            range_m=range_m,
            panorama=PANORAMA,
            lidar=None,
            predictions=predictions,
            evidence=functools.partial(evidence, number),
        )


def made_shown(runs: tuple[str, ...] = RUNS) -> Shown:
    names = [(scene, f"{frame:06d}") for scene in SCENES for frame in range(FRAMES_EACH)]
    return Shown(
        classes=WORLD_CLASSES,
        models=runs,
        grids=(CYLINDER, CUBOID)[: max(len(runs), 1)],
        road_z_m=-2.2,
        frame_interval_s=0.5,
        directions=torch.zeros(0, 3, dtype=torch.float64),
        source="made up",
        fingerprint="0",
        frames=tuple(names),
        read=lambda: made_frames(runs),
    )


def write_made_page(path: Path, runs: tuple[str, ...] = RUNS) -> Path:
    shown = made_shown(runs)
    write_page(shown, shown, path)
    return path
