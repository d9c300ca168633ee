"""Export a trained network for one rig as a file: `python src/export.py checkpoint=... rig=... output=model.pt2`."""

from pathlib import Path

from omegaconf import DictConfig

from omniocc.config import check_values
from omniocc.runs.script import quiet_libraries, require, script


@script("export")
def main(cfg: DictConfig) -> None:
    """Check the options, export, print a line about the files."""
    require(cfg, ("checkpoint", "rig"), "export.py")
    check_values(cfg, dict.fromkeys(("checkpoint", "rig", "output"), str))
    from omniocc.export import export_files
    from omniocc.predict.options import load_rig

    quiet_libraries()
    print(export_files(cfg.checkpoint, load_rig(cfg.rig), Path(cfg.output), cfg.image_width, cfg.road_z_m))


if __name__ == "__main__":
    main()
