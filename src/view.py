"""Look at scenes and predictions, or follow runs: `python src/view.py run=runs/<run>`, `recorded=...`, `watch=runs`."""

from pathlib import Path

from omegaconf import DictConfig

from omniocc.errors import UserError
from omniocc.run.script import quiet_libraries, script
from omniocc.viewer.options import TargetOptions, ViewOptions, options_of
from omniocc.viewer.watch.files import config_of


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
    from omniocc.viewer.collect import open_shown, with_progress

    shown = open_shown(options)
    print(f"{shown.source}: {len(shown)} frames", flush=True)
    if target.page:
        from omniocc.viewer.page import page_path, write_page

        path = page_path(target.output, options.run)
        write_page(shown, with_progress(shown), path)
        print(f"{path}: {path.stat().st_size / 1e6:.1f} MB\n{path.resolve().as_uri()}")
        return path
    try:
        from omniocc.viewer.timeline.show import show
    except ImportError as error:
        raise UserError("the Rerun viewer needs one more package: pip install --editable '.[rerun]'") from error
    path = None if target.save is None else Path(target.save)
    show(shown, path, target.connect)
    if path is not None:
        print(f"{path}: {path.stat().st_size / 1e6:.1f} MB; open it by: rerun {path}")
    return path


if __name__ == "__main__":
    main()
