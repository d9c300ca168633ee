"""Render the virtual dataset of a preset, read it back, or make a page to browse it; see `--help`."""

import sys
import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import cast

import numpy as np
from omegaconf import DictConfig

from omniocc.classes import WORLD_CLASSES
from omniocc.config import check
from omniocc.data import DataError, SceneReader, VirtualWorld
from omniocc.data.labels.class_fractions import fraction_table
from omniocc.data.recording.budget import announcement, begun, size
from omniocc.data.recording.job import ScenePlan
from omniocc.data.store.check import survey, survey_scene
from omniocc.errors import UserError
from omniocc.geometry import Cylinder
from omniocc.parts import Parts
from omniocc.progress import clock
from omniocc.run.script import script

DECODED_FRAMES = 400


@script("render")
def main(cfg: DictConfig) -> None:
    """Check the configuration and build the world; then render it, read it back or draw a page."""
    if "frames_per_scene" not in cfg.data.source:
        raise UserError("render.py renders only scenes of the virtual world: leave data=... out")
    check(cfg.data.source)
    whole_length = cfg.data.source.frames_per_scene
    world = cast(VirtualWorld, Parts(cfg).source(frames_per_scene=whole_length if cfg.frames is None else cfg.frames))
    plans = selected(world.plans, cfg.first_scene, cfg.scenes)
    if cfg.check:
        read_back(world, plans)
    elif cfg.page:
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
    timed = missing and not begun(world, missing)
    began_s = time.monotonic()
    world.prepare(plans)
    elapsed_s = time.monotonic() - began_s
    scenes = [world.reader(plan) for plan in plans]
    frames, taken = sum(map(len, scenes)), total_bytes(scenes)
    print(f"{amount(world, scenes)} ({taken / 1e6 / frames:.2f} a frame)")
    whole = len(world.plans) * whole_length
    if frames < whole:
        print(f"all {len(world.plans)} scenes, {whole} frames: {size(round(taken / frames * whole))}", end="")
        frame_s = elapsed_s / (len(missing) * world.frames_per_scene or 1)
        # a place is built once for all frames of a scene, so long scenes are cheaper
        print(f", at most {clock(frame_s * whole)} with {max(1, world.workers)} processes" if timed else "")


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
    from omniocc.report.dataset.page import save_page  # not needed to render
    from omniocc.viewer.page import PAGE

    missing = world.missing(plans)
    scenes = [world.reader(plan) for plan in plans if plan not in missing]
    if not scenes:
        raise DataError(f"{world.place} has none of these scenes: run without page=true first")
    path = Path(world.folder) / "index.html"
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


if __name__ == "__main__":
    main()
