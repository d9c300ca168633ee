"""Predict ranges or voxels from your own images: `python src/predict.py {depth,occupancy} rig=... images=...`.

`python src/predict.py submission checkpoint=...` writes what a benchmark takes. `occupancy --help` lists the options.
"""

from pathlib import Path

from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from omniocc.extras.viewer.command import open_viewer
from omniocc.runs.script import chosen_command, quiet_libraries, require, script


@script("predict_depth")
def depth(cfg: DictConfig) -> None:
    """Predict a range panorama for every frame."""
    require(cfg, ("images",), "predict.py depth")
    from omniocc.extras.recorders.bag_predictions import BAGS
    from omniocc.predict.depth import predict_panoramas

    overrides = [str(override) for override in HydraConfig.get().overrides.task]
    with open_viewer(cfg.viewer, f"depth, {cfg.output}", "RangeStream") as stream:
        predict_panoramas(cfg, overrides, stream, BAGS)


@script("predict_occupancy")
def occupancy(cfg: DictConfig) -> None:
    """Predict the voxels of every frame."""
    require(cfg, ("checkpoint",), "predict.py occupancy")
    from omniocc.extras.recorders.bag_predictions import BAGS
    from omniocc.predict.occupancy import options_of, predict_occupancy

    quiet_libraries()
    options = options_of(cfg)
    with open_viewer(options.viewer, f"occupancy, {options.output}", "VoxelStream") as stream:
        predict_occupancy(options, stream, BAGS)


@script("predict_submission")
def submission(cfg: DictConfig) -> None:
    """Predict every frame of a dataset's split in the benchmark's submission format."""
    from omniocc.predict.submission import changed_places, predict_submission

    quiet_libraries()
    changes = changed_places(cfg.root, cfg.sequences, cfg.split)
    predict_submission(cfg.checkpoint, Path(cfg.output), cfg.split, changes, cfg.device, cfg.force)


COMMANDS = {"depth": depth, "occupancy": occupancy, "submission": submission}


def main() -> None:
    """Run the command that the first argument names."""
    COMMANDS[chosen_command(COMMANDS, "predict.py")]()


if __name__ == "__main__":
    main()
