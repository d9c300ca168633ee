"""Look at scenes and predictions, or follow runs: `python src/view.py run=runs/<run>`, `recorded=...`, `watch=runs`."""

from omegaconf import DictConfig

from omniocc.extras.viewer.command import view
from omniocc.extras.viewer.options import options_of
from omniocc.runs.script import quiet_libraries, script


@script("view")
def main(cfg: DictConfig) -> None:
    """Show scenes, predictions or runs, in the Rerun viewer, a file or a page; see `conf/view.yaml`."""
    quiet_libraries()
    view(*options_of(cfg))


if __name__ == "__main__":
    main()
