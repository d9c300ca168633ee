"""Files of a predicted range panorama."""

import io
from pathlib import Path

import cv2
import numpy as np

from omniocc.camera import Equirectangular
from omniocc.data.store.codec import quantize_range
from omniocc.draw import save_png
from omniocc.io import atomic_write
from omniocc.model.depth import DepthMap
from omniocc.predict.output.point_cloud import PointCloud, write_ply


def write_depth(
    folder: Path, depth: DepthMap, panorama: Equirectangular, cloud: PointCloud, overview: np.ndarray
) -> int:
    """Write `range.png`, `range.npz`, `points.ply` and `overview.png` of one frame; return the number of points.

    `range.png` is 16 bit, 1/256 m per step as in KITTI's depth maps; 0: no range. `range.npz` holds `range_m` (nan
    where there is no range) and `confidence`, float32 of (height, width), and the panorama's edges `top_deg` and
    `bottom_deg`.

    The folder is created if it is missing. `panorama` has the directions of the pixels, `overview` is (H, W, 3) uint8
    RGB.

    Raises:
        DataError: naming the path that cannot be written.
    """
    range_m = depth.known_range_m()[0]
    _, data = cv2.imencode(".png", quantize_range(range_m.numpy()))
    atomic_write(folder / "range.png", data.tobytes())
    content = io.BytesIO()
    np.savez_compressed(
        content,
        range_m=range_m.numpy(),
        confidence=depth.confidence[0].float().numpy(),
        top_deg=panorama.top_deg,
        bottom_deg=panorama.bottom_deg,
    )
    atomic_write(folder / "range.npz", content.getvalue())
    save_png(folder / "overview.png", overview)
    return write_ply(folder / "points.ply", cloud)
