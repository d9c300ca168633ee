"""Read a dataset back and list all that is wrong with it: the work of `src/check.py`."""

import itertools
from pathlib import Path

import torch

from omniocc.data import OccupancyData
from omniocc.data.check_source import check_source, frames_of, has_labels
from omniocc.data.labels.counts import all_frames
from omniocc.data.labels.ray_votes import rays_seen
from omniocc.data.rays import rays_around
from omniocc.data.source import SPLITS, has_poses
from omniocc.data.spacing import evenly_spaced
from omniocc.draw import save_png
from omniocc.draw.voxel_sheet import data_sheet
from omniocc.errors import FAULTS, DataError, reason_of
from omniocc.loss import RayWindow

SEEN = (1, 3, 10)
"""Numbers of rays at which the bands of `seen_line` begin."""
WINDOWS = RayWindow((0,), False), RayWindow((-2, -1, 0, 1, 2), False)
MOST_FRAMES = 4
"""Frames whose rays are counted, evenly spaced."""


def read_back(data: OccupancyData, frames: int, workers: int, drawn: Path | None) -> int:
    """Read the frames of all scenes, print all problems, and return their number.

    Args:
        data: of which the source is read.
        frames: of each scene, evenly spread; 0: all.
        workers: processes that read; 0: none besides this.
        drawn: folder for an image of the first frame of every split; None draws none.

    Raises:
        UserError: naming an option that does not go with the source.
    """
    data.source.prepare()
    data.source.labels(data.geometry, data.ignore)  # refuses cells that this source cannot know
    for split in SPLITS:
        scenes = data.source.scenes(split)
        print(f"{split:5}  {len(scenes)} scenes, {sum(map(frames_of, scenes))} frames", flush=True)
    names = data.spec.classes.names
    print(f"{len(names)} classes: {', '.join(names)}; train with data.num_classes={len(names)}")
    for scene in (scene for split in SPLITS for scene in data.source.scenes(split) if not has_labels(scene)):
        print(f"{scene.name} has no LiDAR: it serves prediction, not training")
    if drawn is not None:
        draw(data, drawn)
    problems = 0
    for problem in check_source(data.source, data.geometry, frames, workers):
        problems += 1
        print(problem, flush=True)
    if not problems:  # else its frames cannot be read
        for line in filter(None, (seen_line(data, window) for window in WINDOWS)):
            print(line, flush=True)
    return problems


def seen_line(data: OccupancyData, window: RayWindow) -> str | None:
    """Return a line on how many LiDAR rays see the cells of the model's grid, over some training frames; None without.

    Nor is there one for rays of neighbours where a scene has no poses.

    Cells that no ray crosses or hits are unknown to `data.ignore=unobserved` and to `loss=lidar_rays`.
    """
    scenes = data.source.scenes("train")
    if any(window.frames) and not all(map(has_poses, scenes)):
        return None
    frames = all_frames(scenes)
    found = [rays_around(*frames[number], window) for number in evenly_spaced(len(frames), MOST_FRAMES)]
    counts = [rays_seen(data.geometry, rays) for rays in found if rays is not None]
    if not counts:
        return None
    band = torch.bucketize(torch.stack(counts), torch.tensor(SEEN), right=True).flatten()
    parts = (band.bincount(minlength=len(SEEN) + 1) / len(band)).tolist()
    words = "no ray", *(f"{low} to {high - 1}" for low, high in itertools.pairwise(SEEN)), f"{SEEN[-1]} or more"
    shares = ", ".join(f"{100 * part:.0f} % by {word}" for part, word in zip(parts, words, strict=True))
    return f"seen      of the cells, with the rays of frames {list(window.frames)}: {shares} ({len(counts)} frames)"


def draw(data: OccupancyData, folder: Path) -> None:
    """Draw the first frame of every split: ranges on the images, voxels; name the one that cannot be read."""
    benchmark, classes = data.spec.benchmark, data.spec.classes
    grid = data.geometry if benchmark is None else benchmark.grid
    labels = data.source.labels(grid, "none")
    for split in SPLITS:
        for scene in data.source.scenes(split)[:1]:
            known = has_labels(scene)
            try:
                if known:
                    labels.prepare([scene])
                parts = scene.images(0), scene.rigs[0], scene.camera_range_m(0), scene.erp_range_m(0)
                voxels = labels.read(scene, 0) if known else None
            except (DataError, *FAULTS) as error:
                print(f"the first frame of {split} cannot be drawn: {reason_of(error)}", flush=True)
                continue
            path = folder / f"{split}-{scene.name}.png"
            save_png(path, data_sheet(*parts, voxels, grid, classes, f"{split}: {scene.name}, frame 0"))
            print(f"image    {path}", flush=True)
