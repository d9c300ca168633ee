"""Render the virtual dataset of a preset, read it back, or make a page to browse it; see `--help`."""

from typing import TYPE_CHECKING, cast

from omegaconf import DictConfig

from omniocc.bounds import Number, NumberOrNone
from omniocc.config import check, check_values
from omniocc.errors import UserError
from omniocc.parts import Parts
from omniocc.runs.script import script

if TYPE_CHECKING:
    from omniworld import VirtualWorld


@script("render", "the same command goes on")
def main(cfg: DictConfig) -> None:
    """Check the configuration and build the world; then render it, read it back or draw a page."""
    if "frames_per_scene" not in cfg.data.source:
        raise UserError("render.py renders only scenes of the virtual world: leave data=... out")
    check_values(cfg, dict.fromkeys(("scenes", "frames"), Number | None) | {"first_scene": NumberOrNone})
    check(cfg.data.source)
    from omniworld.command import use_world

    whole_length = cfg.data.source.frames_per_scene
    world = cast("VirtualWorld", Parts(cfg).source(frames_per_scene=whole_length if cfg.frames is None else cfg.frames))
    use = "check" if cfg.check else "page" if cfg.page else "render"
    use_world(world, cfg.first_scene, cfg.scenes, whole_length, use)


if __name__ == "__main__":
    main()
