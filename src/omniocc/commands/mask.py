"""Mask the pixels in which a rig's cameras see their own car: `python src/mask.py rig=... output=...`; see `--help`."""

from pathlib import Path

from omegaconf import DictConfig

from omniocc.config import check_values
from omniocc.runs.script import require, script


@script("mask")
def main(cfg: DictConfig) -> None:
    """Find the pixels, write the masked rig and an image."""
    require(cfg, ("output",), "mask.py")
    check_values(cfg, {"output": str})
    from omniworld.mask import mask_own_car

    mask_own_car(cfg.rig, cfg.scenes, cfg.car, cfg.grow_px, Path(cfg.output))


if __name__ == "__main__":
    main()
