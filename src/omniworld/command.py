"""Render the virtual world, read it back, or make a page to browse it: what `src/render.py` does with its options."""

import shutil
import sys
import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np

from omniocc.classes import WORLD_CLASSES
from omniocc.data import SceneReader
from omniocc.data.store.check import survey, survey_scene
from omniocc.errors import DataError, UserError
from omniocc.geometry import Cylinder
from omniocc.progress import clock
from omniworld.class_fractions import fraction_table
from omniworld.plans import ScenePlan
from omniworld.source import VirtualWorld

DECODED_FRAMES = 400
OTHER_BYTES = 45_000
"""Size of ego LiDAR, poses and boxes, tar headers and the frame's lines in the index."""
GEOMETRY_BYTES = 800_000
RIGS = 20
"""Drawn rigs over which the size is averaged."""


def use_world(
    world: VirtualWorld, first: int, count: int | None, whole_length: int, use: Literal["render", "check", "page"]
) -> None:
    """Render scenes of a world, read them back or draw a page.

    Args:
        world: whose scenes are used.
        first: number of the first scene.
        count: of scenes; None: all from the first on.
        whole_length: frames that the scenes of the data set have, which may be more than are rendered now.
        use: what is done with them.

    Raises:
        UserError: when no scenes are chosen.
        DataError: when the disk refuses, or there is nothing to draw.
    """
    plans = selected(world.plans, first, count)
    if use == "check":
        read_back(world, plans)
    elif use == "page":
        draw_page(world, plans)
    else:
        render(world, plans, whole_length)


def selected(plans: Sequence[ScenePlan], first: int, count: int | None) -> Sequence[ScenePlan]:
    """Return the scenes to work on; raise UserError when there are none."""
    end = len(plans) if count is None else first + count
    if first < 0 or end <= first or not plans[first:end]:
        raise UserError(f"first_scene={first} scenes={count}: choose some of the {len(plans)} scenes of this preset")
    return plans[first:end]


def render(world: VirtualWorld, plans: Sequence[ScenePlan], whole_length: int) -> None:
    """Print what will be rendered, render it, print its size and the cost of all scenes of `whole_length` frames."""
    missing = world.missing(plans)
    if isinstance(world.place, Path):
        print(announcement(world, plans), flush=True)
    began_s = time.monotonic()
    world.prepare(plans)
    elapsed_s = time.monotonic() - began_s
    scenes = [world.reader(plan) for plan in plans]
    frames, taken = sum(map(len, scenes)), total_bytes(scenes)
    print(f"{amount(world, scenes)} ({taken / 1e6 / frames:.2f} a frame)")
    whole = len(world.plans) * whole_length
    if frames < whole:
        cost = size(round(taken / frames * whole))
        print(f"the whole preset, {len(world.plans)} scenes, {whole} frames: {cost}", end="")
        frame_s = elapsed_s / (len(missing) * world.frames_per_scene or 1)
        # a place is built once for all frames of a scene, so long scenes are cheaper
        print(f", at most {clock(frame_s * whole)} with {max(1, world.workers)} processes" if missing else "")


def read_back(world: VirtualWorld, plans: Sequence[ScenePlan]) -> None:
    """Print one line per problem, and the classes beside those of the paper's dataset; exit with 1 if there are any."""
    missing = world.missing(plans)
    problems = [f"{world.place}: scene '{plan.name}' is missing: run without check=true" for plan in missing]
    scenes = [world.reader(plan) for plan in plans if plan not in missing]
    decoded = max(1, DECODED_FRAMES // len(plans))
    work = partial(survey_scene, world.frames_per_scene, world.frame_interval_s, Cylinder(), decoded)
    found = survey(work, scenes, world.workers)
    problems += [line for result in found for line in result.problems]
    if found:
        print(fraction_table(np.sum([result.voxels for result in found], axis=0)))
    if problems:
        print("\n".join(problems))
        sys.exit(1)
    print(f"{amount(world, scenes)}: no problems found")


def draw_page(world: VirtualWorld, plans: Sequence[ScenePlan]) -> None:
    """Write the page beside the existing scenes."""
    from omniocc.runs.folder import PAGE
    from omniworld.page import save_page  # not needed to render

    missing = world.missing(plans)
    scenes = [world.reader(plan) for plan in plans if plan not in missing]
    if not scenes:
        raise DataError(f"{world.place} has none of these scenes: run without page=true first")
    path = Path(world.folder) / "scenes.html"  # index.html would hide the folder's list of files from readers over HTTP
    save_page(path, scenes, Cylinder(), WORLD_CLASSES)
    absent = f", {len(missing)} missing" if missing else ""
    print(f"{path}: {path.stat().st_size / 1e6:.1f} MB, {len(scenes)} scenes{absent}")
    print(f"{path.with_name(PAGE)}: {path.with_name(PAGE).stat().st_size / 1e6:.1f} MB, their voxels to turn")


def amount(world: VirtualWorld, scenes: Sequence[SceneReader]) -> str:
    """Return the place, number and size of the scenes in words."""
    return f"{world.place}: {len(scenes)} scenes, {sum(map(len, scenes))} frames, {size(total_bytes(scenes))}"


def total_bytes(scenes: Sequence[SceneReader]) -> int:
    """Return the size of all files that the scenes list, bytes."""
    return sum(facts["size"] for scene in scenes for facts in scene.meta["files"].values())


def frame_bytes(world: VirtualWorld) -> int:
    """Return the mean size of a recorded frame in bytes, by power laws fitted to frames of all eight places.

    Measured, in kB: 4.9, 35.4, 105.7, 325 for a camera of 64x36, 256x144, 512x288, 1024x576 px; 0.7, 5.4, 40.7 for a
    panorama of 48x12, 180x45, 720x180 px; 51, 137, 207, 318, 475 for points of 1, 5, 10, 20, 40 LiDARs. Places differ
    by 15 percent.
    """
    rigs = [world.rig_of(plan) for plan in world.plans[:RIGS]] if world.rig is None else [world.rig]
    cameras = sum(8.73 * (camera.width * camera.height) ** 0.79 for rig in rigs for camera in rig.cameras) / len(rigs)
    panorama = 5.96 * (world.erp_size[0] * world.erp_size[1]) ** 0.75
    points = GEOMETRY_BYTES if world.label_mode == "geometry" else 318_000 * (world.lidars / 20) ** 0.6
    return round(cameras + panorama + points + OTHER_BYTES)


def bytes_to_come(world: VirtualWorld, missing: Sequence[ScenePlan]) -> int:
    """Return by how many bytes rendering these scenes fills the disk; what an interrupted run left of them goes."""
    left = (world.folder / f"{plan.name}.partial" for plan in missing)
    written = sum(path.stat().st_size for folder in left for path in folder.glob("*.tar"))
    return max(0, len(missing) * world.frames_per_scene * frame_bytes(world) - written)


def announcement(world: VirtualWorld, plans: Sequence[ScenePlan]) -> str:
    """Return a line about the scenes that a run will render, the disk space they take and the free space.

    Raises:
        DataError: when the disk has less space than the scenes will take.
    """
    missing = world.missing(plans)
    if not missing:
        return f"{world.place}: all {len(plans)} scenes exist"
    frames, needed = len(missing) * world.frames_per_scene, bytes_to_come(world, missing)
    free = shutil.disk_usage(existing(world.folder)).free
    if needed > free:
        raise DataError(
            f"{world.place}: {len(missing)} scenes of {world.frames_per_scene} frames take about {size(needed)}, the "
            f"disk has {size(free)} free: free some space, choose another folder (paths.data=...), or render fewer "
            f"scenes (scenes=...); nothing was written"
        )
    complete = f", {len(plans) - len(missing)} exist" if len(missing) < len(plans) else ""
    return (
        f"{world.place}: {len(missing)} of {len(plans)} scenes to render{complete}, {frames:,} frames, about "
        f"{size(needed)}, {size(free)} free"
    )


def existing(folder: Path) -> Path:
    """Return the folder, or the nearest folder above it that exists."""
    return next(path for path in (folder.absolute(), *folder.absolute().parents) if path.exists())


def size(count: int) -> str:
    """Return a number of bytes in MB or GB."""
    return f"{count / 1e9:.1f} GB" if count >= 1e9 else f"{count / 1e6:.0f} MB"
