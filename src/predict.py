"""Apply a trained model to your own images: `python src/predict.py {depth,occupancy} rig=... images=...`.

`python src/predict.py submission checkpoint=...` writes what a benchmark takes. `occupancy --help` lists the options.
"""

import sys
from pathlib import Path
from types import ModuleType

from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from omniocc.errors import UserError, installing
from omniocc.predict.depth import predict_panoramas
from omniocc.predict.occupancy import options_of, predict_occupancy
from omniocc.predict.submission import predict_submission
from omniocc.run.script import quiet_libraries, script


@script("predict_depth")
def depth(cfg: DictConfig) -> None:
    """Predict a range panorama for every frame."""
    overrides = [str(override) for override in HydraConfig.get().overrides.task]
    if cfg.viewer is None:
        return predict_panoramas(cfg, overrides)
    with timeline().to_viewer(cfg.viewer, f"depth, {cfg.output}") as recording:
        return predict_panoramas(cfg, overrides, timeline().RangeStream(recording))


@script("predict_occupancy")
def occupancy(cfg: DictConfig) -> None:
    """Predict the voxels of every frame."""
    quiet_libraries()
    options = options_of(cfg)
    if options.viewer is None:
        return predict_occupancy(options)
    with timeline().to_viewer(options.viewer, f"occupancy, {options.output}") as recording:
        return predict_occupancy(options, timeline().VoxelStream(recording))


@script("predict_submission")
def submission(cfg: DictConfig) -> None:
    """Predict every frame of a dataset's split in the benchmark's submission format."""
    quiet_libraries()
    changes = [] if cfg.root is None else [f"data.source.root={cfg.root}"]
    if cfg.sequences is not None:
        given = [cfg.sequences] if isinstance(cfg.sequences, int | str) else list(cfg.sequences)
        changes.append(f"data.source.sequences.{cfg.split}={given}")
    predict_submission(cfg.checkpoint, Path(cfg.output), cfg.split, changes, cfg.device, cfg.force)


def timeline() -> ModuleType:
    """Return the module that streams frames into the Rerun viewer; raise UserError without its package."""
    try:
        from omniocc.viewer.timeline import stream
    except ImportError as error:
        raise UserError(f"viewer=... needs one more package: {installing('rerun')}") from error
    return stream


COMMANDS = {"depth": depth, "occupancy": occupancy, "submission": submission}


def main() -> None:
    """Run the command that the first argument names."""
    if len(sys.argv) < 2 or sys.argv[1] not in COMMANDS:
        asked = len(sys.argv) > 1 and sys.argv[1] in ("-h", "--help")
        print(
            f"usage: python src/predict.py {{{','.join(COMMANDS)}}} key=value ...    (<command> --help lists its keys)"
        )
        sys.exit(0 if asked else 2)
    COMMANDS[sys.argv.pop(1)]()


if __name__ == "__main__":
    main()
