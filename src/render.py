"""Render the virtual dataset of a preset, or read it back and list what is wrong. `--help` lists what can be chosen."""

import sys

import hydra
from omegaconf import DictConfig

from omniocc.config import build, check, lines_not_tracebacks
from omniocc.data import DataError, VirtualWorld
from omniocc.data.check import check_scene
from omniocc.data.virtual import SPLITS


@hydra.main(version_base="1.3", config_path="../conf", config_name="render")
@lines_not_tracebacks
def main(cfg: DictConfig) -> None:
    """Check -> build -> render or read back."""
    check(cfg.data.world)
    world = build(cfg.data.world)
    try:
        if cfg.check:
            read_back(world)
        else:
            world.prepare()
    except DataError as error:
        sys.exit(str(error))
    scenes = [scene for split in SPLITS for scene in world.readers(split)]
    megabytes = sum(facts["size"] for scene in scenes for facts in scene.meta["files"].values()) / 1e6
    frames = sum(map(len, scenes))
    print(
        f"{world.folder}: {len(scenes)} scenes, {frames} frames, {megabytes:.0f} MB ({megabytes / frames:.2f} a frame)"
    )


def read_back(world: VirtualWorld) -> None:
    """Print one line per problem; exit code 1 if there is any."""
    missing = [f"{world.folder / plan.name}: the scene is missing: run without check=true" for plan in world.missing()]
    scenes = [] if missing else [scene for split in SPLITS for scene in world.readers(split)]
    problems = missing + [problem for scene in scenes for problem in check_scene(scene, world.frames_per_scene)]
    if problems:
        print("\n".join(problems))
        sys.exit(1)
    print("everything is whole")


if __name__ == "__main__":
    main()
