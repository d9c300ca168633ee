"""Look at scenes and predictions, or follow runs: `python src/view.py run=runs/<run>`, `recorded=...`, `watch=runs`."""

from pathlib import Path
from typing import TYPE_CHECKING

from omegaconf import DictConfig

from omniocc.errors import UserError, installing
from omniocc.run.script import quiet_libraries, script
from omniocc.viewer.options import TargetOptions, ViewOptions, options_of
from omniocc.viewer.watch.files import config_of

if TYPE_CHECKING:
    from omniocc.viewer.frames import Shown


@script("view")
def main(cfg: DictConfig) -> None:
    """Show what the options choose in the Rerun viewer, a file or a page."""
    quiet_libraries()
    options, target = options_of(cfg)
    if options is None:
        from omniocc.viewer.watch.server import watch  # starts at once, without torch

        watch(Path(str(target.watch)), target.port)
        return
    path = written(options, target)
    if path is not None and target.wandb:
        from omniocc.run.wandb.artifact import log_file

        folder = Path(options.run[0])
        log_file(folder, path, config_of(folder / "config.yaml").get("logger", {}).get("project", "omniocc"))
        print(f"{path} is kept in {folder}/wandb; upload it by: make wandb-sync")


def written(options: ViewOptions, target: TargetOptions) -> Path | None:
    """Show the frames and return the file that they were written to; None for a viewer."""
    if target.page:
        return written_page(options, target)
    try:
        from omniocc.viewer.timeline.show import show
        from omniocc.viewer.timeline.sinks import check_place
    except ImportError as error:
        raise UserError(f"the Rerun viewer needs one more package: {installing('rerun')}") from error
    path = None if target.save is None else Path(target.save)
    check_place(path, target.connect)
    show(opened(options), path, target.connect)
    if path is not None:
        print(f"{path}: {path.stat().st_size / 1e6:.1f} MB; open it by: rerun {path}")
    return path


def written_page(options: ViewOptions, target: TargetOptions) -> Path:
    """Write the frames to a page and return its path."""
    from omniocc.viewer.collect import with_progress
    from omniocc.viewer.page import page_path, write_page

    path, shown = page_path(target.output, options.run), opened(options)
    write_page(shown, with_progress(shown), path)
    print(f"{path}: {path.stat().st_size / 1e6:.1f} MB\n{path.resolve().as_uri()}")
    return path


def opened(options: ViewOptions) -> "Shown":
    """Return the frames, and print where they come from."""
    from omniocc.viewer.collect import open_shown

    shown = open_shown(options)
    print(f"{shown.source}: {len(shown)} frames", flush=True)
    return shown


if __name__ == "__main__":
    main()
