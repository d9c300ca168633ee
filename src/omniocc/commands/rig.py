"""Begin a rig file or look at one: `python src/rig.py new lens=mei cameras=4`, `python src/rig.py show my_rig.yaml`."""

import sys
from pathlib import Path

from omegaconf import DictConfig, ListConfig

from omniocc.config import check_values, quoted
from omniocc.runs.script import chosen_command, quiet_libraries, require, script


@script("rig_new")
def new(cfg: DictConfig) -> None:
    """Write a rig file in which every key is explained."""
    from omniocc.predict.rig_file import write_rig_file

    write_rig_file(cfg.lens, cfg.cameras, Path(cfg.file), cfg.force)


@script("rig_show")
def show(cfg: DictConfig) -> None:
    """Draw a rig, print a table of its cameras and what is suspicious."""
    require(cfg, ("rig",), "rig.py show")
    from omniocc.predict.input.images import names_of
    from omniocc.predict.rig_file import show_rig

    quiet_libraries()
    images = [str(path) for path in cfg.images] if isinstance(cfg.images, ListConfig) else cfg.images
    check_values(cfg, {"rig": str, "output": str, "image_bits": int | None})
    show_rig(cfg.rig, images, Path(cfg.output), names_of(cfg.exclude_cameras), cfg.image_bits)


COMMANDS = {"new": new, "show": show}


def main() -> None:
    """Run the command that the first argument names; `show` takes the rig without its key."""
    command = chosen_command(COMMANDS, "rig.py")
    if command == "show" and len(sys.argv) > 1 and "=" not in sys.argv[1] and not sys.argv[1].startswith("-"):
        sys.argv[1] = f"rig={quoted(sys.argv[1])}"
    COMMANDS[command]()


if __name__ == "__main__":
    main()
