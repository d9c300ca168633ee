"""Files of a predicted panorama of range."""

from pathlib import Path

import cv2
import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from omniocc.camera import Equirectangular
from omniocc.model.depth import DepthMap
from omniocc.predict.output.cloud import Cloud, write_ply
from omniocc.view import save_png

STEPS_PER_M = 256
"""Of the 16-bit picture, as in KITTI's depth maps; 0 is no answer, and 65535 stands for everything beyond 256 m."""


def write_depth(folder: Path, depth: DepthMap, panorama: Equirectangular, cloud: Cloud, picture: np.ndarray) -> int:
    """Writes `range.png`, `range.npz`, `points.ply` and `picture.png`.

    `range.npz` holds `range_m` (nan where there is no answer) and `confidence`, float32 of (height, width), and the
    panorama's edges `top_deg` and `bottom_deg`.

    Args:
        folder: made if missing.
        depth: of one frame.
        panorama: its directions.
        cloud: its points.
        picture: for people.

    Returns:
        how many points the cloud has.

    Raises:
        OSError: naming the path that cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    range_m = depth.known_range_m()[0]
    _, data = cv2.imencode(".png", range_code(range_m))
    (folder / "range.png").write_bytes(data.tobytes())
    np.savez_compressed(
        folder / "range.npz",
        range_m=range_m.numpy(),
        confidence=depth.confidence[0].float().numpy(),
        top_deg=panorama.top_deg,
        bottom_deg=panorama.bottom_deg,
    )
    save_png(folder / "picture.png", picture)
    return write_ply(folder / "points.ply", cloud)


def range_code(range_m: Float[Tensor, "h w"]) -> np.ndarray:
    """(h, w) uint16: steps of 1/256 m, at least 1; 0 where there is no answer."""
    code = (range_m.nan_to_num(0.0) * STEPS_PER_M).round().clamp(1, 65535)
    return torch.where(range_m.isfinite(), code, 0).to(torch.int32).numpy().astype(np.uint16)
