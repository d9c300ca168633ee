"""Frames as the page reads them: facts as plain data, and blocks of text for labels, tables and images."""

import base64
import gzip
import math
from collections.abc import Iterable
from typing import Any

import cv2
import numpy as np

from omniocc.camera import Equirectangular, Rig
from omniocc.draw.canvas import encoded, fitted
from omniocc.draw.ranges import NOT_PREDICTED, SKY, range_colors, range_scale
from omniocc.draw.sheet import HEXAGON_ORDER
from omniocc.draw.voxels import CAR_BOXES
from omniocc.extras.viewer.frames import FramePrediction, Shown, ShownFrame
from omniocc.extras.viewer.page.colors import class_colors, kind_colors
from omniocc.extras.viewer.page.lens import direction_table
from omniocc.geometry import Cylinder, Grid

IMAGE_PX = 1024
"""Largest width of an image in the page unless another one is asked for."""
IMAGE_QUALITY = 80
"""Of images as JPEG, 1 to 100."""
RANGE_COLORS = 25
"""Number of colours in the bar that explains ranges; the browser interpolates."""
CAR_ROAD_Z_M = -2.2
"""Height of the road that the boxes of the ego car stand on, and of one that is not known."""
FIGURES = {
    "rayiou": "voxel RayIoU",
    "iou": "IoU",
    "miou": "mIoU",
    "rayiou@1": "RayIoU, 1 m",
    "rayiou@2": "RayIoU, 2 m",
    "rayiou@4": "RayIoU, 4 m",
    "lidar/rayiou": "surface RayIoU",
}
"""Figures of a frame that the page shows, and their names."""


class Packed:
    """The content of a page: `facts` are plain data for JSON, `blocks` texts by name, which the facts refer to."""

    def __init__(self, shown: Shown, image_px: int):
        self.image_px = image_px
        self.blocks: dict[str, str] = {}
        self._grids: dict[Grid, int] = {}
        self._rigs: dict[Rig, int] = {}
        self.road_z_m = CAR_ROAD_Z_M if shown.road_z_m is None else shown.road_z_m
        self.facts: dict[str, Any] = {
            "classes": class_colors(shown.classes),
            "kinds": kind_colors(),
            "ranges": _ranges(),
            "figures": [{"key": key, "name": name} for key, name in FIGURES.items()],
            "runs": list(shown.models),
            "grids": [],
            "rigs": [],
            "frames": [],
            "car": {"road_z_m": CAR_ROAD_Z_M, "boxes": [{"bounds": bounds, "rgb": rgb} for bounds, rgb in CAR_BOXES]},
        }
        for grid in shown.grids:
            self._grid(grid)

    def add(self, frame: ShownFrame) -> None:
        """Add a frame."""
        panoramas = [("true", frame.range_m, frame.panorama)]
        panoramas += [(name, found.range_m, found.panorama) for name, found in frame.predictions.items()]
        self.facts["frames"].append(
            {
                "scene": frame.scene,
                "frame": frame.frame,
                "time_s": frame.time_s,
                "road_z_m": self.road_z_m if frame.rig is None or frame.rig.road_z_m is None else frame.rig.road_z_m,
                "rig": None if frame.rig is None or not frame.images else self._rig(frame.rig),
                "images": [self._image(image) for image in frame.images],
                "truth": {self._grid(grid): self._bytes(labels.numpy()) for grid, labels in frame.truth.items()},
                "predictions": [self._prediction(frame.predictions.get(name)) for name in self.facts["runs"]],
                "panoramas": [
                    self._panorama(name, range_m.numpy(), panorama)
                    for name, range_m, panorama in panoramas
                    if range_m is not None and panorama is not None
                ],
            }
        )

    def _prediction(self, prediction: FramePrediction | None) -> dict[str, Any] | None:
        if prediction is None:
            return None
        figures = {key: value for key, value in prediction.figures.items() if key in FIGURES and math.isfinite(value)}
        return {
            "grid": self._grid(prediction.grid),
            "labels": self._bytes(prediction.labels.numpy()),
            "figures": figures,
        }

    def _grid(self, grid: Grid) -> int:
        if grid not in self._grids:
            self._grids[grid] = len(self._grids)
            kind = "cylinder" if isinstance(grid, Cylinder) else "cuboid"
            self.facts["grids"].append({"kind": kind, "shape": grid.shape, "bounds": grid.bounds})
        return self._grids[grid]

    def _rig(self, rig: Rig) -> int:
        if rig not in self._rigs:
            self._rigs[rig] = len(self._rigs)
            count = len(rig.cameras)
            order = HEXAGON_ORDER if count == len(HEXAGON_ORDER) else range(count)
            cameras = [self._camera(rig, k) for k in range(count)]
            self.facts["rigs"].append({"cameras": cameras, "order": list(order)})
        return self._rigs[rig]

    def _camera(self, rig: Rig, camera: int) -> dict[str, Any]:
        table, model, pose = direction_table(rig, camera), rig.cameras[camera], rig.ego_from_camera[camera]
        return {
            "name": rig.names[camera],
            "width": model.width,
            "height": model.height,
            "origin": pose[:3, 3].tolist(),
            "forward": pose[:3, 2].tolist(),
            "step": table.step,
            "rows": table.directions.shape[0],
            "columns": table.directions.shape[1],
            "directions": self._bytes(table.directions.astype("<i2")),
            "valid": self._bytes(np.packbits(table.valid)),
        }

    def _panorama(self, name: str, range_m: np.ndarray, panorama: Equirectangular) -> dict[str, Any]:
        return {
            "of": name,
            "width": panorama.width,
            "height": panorama.height,
            "top_deg": panorama.top_deg,
            "bottom_deg": panorama.bottom_deg,
            "image": self._encoded(range_colors(range_m), "png", []),
        }

    def _image(self, image: np.ndarray) -> dict[str, str]:
        smaller = fitted(image, self.image_px) if image.shape[1] > self.image_px else image
        return self._encoded(smaller, "jpeg", [cv2.IMWRITE_JPEG_QUALITY, IMAGE_QUALITY, cv2.IMWRITE_JPEG_OPTIMIZE, 1])

    def _encoded(self, image: np.ndarray, kind: str, options: list[int]) -> dict[str, str]:
        return {"format": kind, "block": self._block(encoded(image, kind, options))}

    def _bytes(self, array: np.ndarray) -> str:
        """Add the bytes of an array, compressed."""
        return self._block(gzip.compress(np.ascontiguousarray(array).tobytes(), 9, mtime=0))

    def _block(self, data: bytes) -> str:
        name = f"block-{len(self.blocks)}"
        self.blocks[name] = base64.b64encode(data).decode()
        return name


def _ranges() -> dict[str, Any]:
    """Return what explains the colours of ranges."""
    colors, ticks = range_scale(RANGE_COLORS)
    return {
        "colors": colors.tolist(),
        "ticks": [{"range_m": range_m, "place": place} for range_m, place in ticks],
        "sky": SKY,
        "unknown": NOT_PREDICTED,
    }


def pack(shown: Shown, frames: Iterable[ShownFrame], image_px: int = IMAGE_PX) -> Packed:
    """Return the content of a page with these frames; wider images are scaled to `image_px`."""
    packed = Packed(shown, image_px)
    for frame in frames:
        packed.add(frame)
    return packed
