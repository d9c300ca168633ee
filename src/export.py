"""A trained network for one rig as a file: `python src/export.py checkpoint=... rig=... output=model.pt2`."""

from pathlib import Path

from omegaconf import DictConfig, OmegaConf

from omniocc.camera import Rig
from omniocc.errors import UserError
from omniocc.export import Options, export_files
from omniocc.run.script import quiet_libraries, script


@script("export")
def main(cfg: DictConfig) -> None:
    """Check -> export -> a line about the files."""
    quiet_libraries()
    for key in ("checkpoint", "rig"):
        if OmegaConf.is_missing(cfg, key):
            raise UserError(f"{key}=... is needed; see python src/export.py --help")
    try:
        rig = Rig.load(cfg.rig)
    except ValueError as error:
        raise UserError(f"rig={cfg.rig}: {error}") from error
    print(export_files(Options(Path(cfg.checkpoint), rig, Path(cfg.output), cfg.image_width)))


if __name__ == "__main__":
    main()
