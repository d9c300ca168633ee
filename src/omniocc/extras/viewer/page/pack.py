"""Frames as the page reads them: facts as plain data, and blocks of text for labels, tables and images."""

import base64
import gzip
import itertools
import math
from collections.abc import Iterable
from typing import Any, NamedTuple

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float64, Int16

from omniocc.camera import Equirectangular, Rig
from omniocc.classes import FREE, ClassTable
from omniocc.draw.bev import ERRORS
from omniocc.draw.canvas import Rgb, encode_image, fitted
from omniocc.draw.ranges import NOT_PREDICTED, SKY, range_colors, range_scale
from omniocc.draw.sheet import HEXAGON_ORDER
from omniocc.draw.voxels import CAR_BOXES
from omniocc.extras.viewer.frames import FramePrediction, Shown, ShownFrame
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
SAFE: tuple[Rgb, ...] = (
    (120, 120, 135),
    (240, 210, 255),
    (180, 135, 90),
    (45, 60, 90),
    (105, 30, 150),
    (105, 255, 180),
    (255, 120, 15),
    (75, 150, 210),
    (105, 45, 0),
    (195, 30, 255),
    (180, 255, 120),
    (150, 180, 165),
    (210, 60, 0),
    (0, 0, 240),
    (255, 210, 0),
    (165, 60, 75),
    (75, 105, 150),
    (255, 15, 195),
    (90, 0, 180),
    (120, 225, 120),
)
"""Colours that colour-blind people can tell apart, by class from 1 on; the first eleven are those of the virtual world.

They were chosen one after the other, each as far as possible from those before: the smallest CIELAB distance between
two of them, as people with normal sight, protanopes, deuteranopes and tritanopes see them (Machado, Oliveira and
Fernandes: A Physiologically-based Model for Simulation of Color Vision Deficiency, 2009), is at least 26 among the
first eleven and 17 among all.
"""
SAFE_KINDS: dict[str, Rgb] = {
    "right": (214, 219, 224),
    "wrong class": (255, 180, 0),
    "missed": (0, 90, 200),
    "hallucinated": (150, 30, 30),
}
"""By kind of difference, in the order in which the page numbers them from 1 on."""
MOST_COUNTED = 255
"""Points or rays of a cell that the page tells apart: a byte."""
STEPS = (64, 32, 16, 8, 4, 2, 1)
"""Distances between the pixels of a table, px; the largest that is exact enough is taken."""
LARGEST_ERROR_DEG = 0.04
"""Between an interpolated direction and the lens model's, over all pixels that the camera sees."""
QUICK = 61
"""A table is first tried on each so manieth pixel; a prime, so that these are not in a few columns alone."""
UNIT = 32767
"""Length of a direction in a table."""


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
                "evidence": {self._grid(grid): self._evidence(frame, grid) for grid in frame.truth if frame.evidence},
                "predictions": [self._prediction(frame.predictions.get(name)) for name in self.facts["runs"]],
                "panoramas": [
                    self._panorama(name, range_m.numpy(), panorama)
                    for name, range_m, panorama in panoramas
                    if range_m is not None and panorama is not None
                ],
            }
        )

    def _evidence(self, frame: ShownFrame, grid: Grid) -> str:
        """Add the numbers of points and rays of every cell, each at most `MOST_COUNTED`."""
        assert frame.evidence is not None
        return self._bytes(frame.evidence(grid).clamp(max=MOST_COUNTED).to(torch.uint8).numpy())

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
        return {"format": kind, "block": self._block(encode_image(image, kind, options))}

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


def class_colors(classes: ClassTable) -> list[dict]:
    """Return name, colour and colour-blind-safe colour of every class; classes beyond `SAFE` keep their colour."""
    safe = {label: SAFE[label - 1] for label in range(1, min(len(SAFE) + 1, classes.num_classes))}
    rows = [{"name": row.name, "rgb": row.rgb, "safe": safe.get(row.id, row.rgb)} for row in classes.rows]
    assert rows[FREE]["safe"] == rows[FREE]["rgb"]
    return rows


def kind_colors() -> list[dict]:
    """Return the same for the kinds of differences; the first entry stands for 'none'."""
    colors = dict(ERRORS)
    kinds = [{"name": name, "rgb": colors[name], "safe": safe} for name, safe in SAFE_KINDS.items()]
    return [{"name": "", "rgb": (0, 0, 0), "safe": (0, 0, 0)}, *kinds]


class DirectionTable(NamedTuple):
    """Directions of one camera's pixels.

    Attributes:
        step: distance between neighbouring entries, px; the first is the centre of pixel (0, 0).
        directions: ego frame, times `UNIT`; linear interpolation between entries gives the direction of any pixel.
        valid: pixels that the lens sees and the mask does not hide.
        error_deg: largest error found.
    """

    step: int
    directions: Int16[np.ndarray, "rows columns 3"]
    valid: Bool[np.ndarray, "height width"]
    error_deg: float


def direction_table(rig: Rig, camera: int) -> DirectionTable:
    """Return the coarsest table of a camera whose error is at most `LARGEST_ERROR_DEG`, else one of every pixel."""
    exact, valid = rig.rays(camera)
    exact, valid = exact.double().numpy(), valid.numpy()
    v, u = np.nonzero(valid)
    for step, continued in itertools.product(STEPS, (False, True)):
        table, error_deg = _entries(rig, camera, step, continued), 0.0
        for every in (QUICK, 1):
            rows, columns = v[::every], u[::every]
            found = interpolate(table, step, columns, rows)
            error_deg = float(_angle_deg(found, exact[rows, columns]).max(initial=0.0))
            if error_deg > LARGEST_ERROR_DEG and step > STEPS[-1]:
                break
        else:
            return DirectionTable(step, table, valid, error_deg)
    raise AssertionError("the last of STEPS is always taken")


def interpolate(
    table: Int16[np.ndarray, "rows columns 3"], step: int, u: np.ndarray, v: np.ndarray
) -> Float64[np.ndarray, "P 3"]:
    """Return the unit directions of pixels as `static/lens.js` finds them."""
    columns = np.clip(np.floor(u / step), 0, table.shape[1] - 2).astype(int)
    rows = np.clip(np.floor(v / step), 0, table.shape[0] - 2).astype(int)
    right, below = (u / step - columns)[:, None], (v / step - rows)[:, None]
    upper = table[rows, columns] * (1 - right) + table[rows, columns + 1] * right
    lower = table[rows + 1, columns] * (1 - right) + table[rows + 1, columns + 1] * right
    mixed = upper * (1 - below) + lower * below
    return mixed / np.linalg.norm(mixed, axis=1, keepdims=True)


def _entries(rig: Rig, camera: int, step: int, continued: bool) -> Int16[np.ndarray, "rows columns 3"]:
    """Return the directions at every `step` pixels, up to the image's last pixel or the first entry beyond it.

    Beyond the lens's field of view they are those of its model, or those inside it continued linearly: some models end
    there, and pixels at the border lie between entries on both sides.
    """
    model = rig.cameras[camera]
    columns, rows = (max(-(-(size - 1) // step), 1) + 1 for size in (model.width, model.height))
    v, u = torch.meshgrid(torch.arange(rows), torch.arange(columns), indexing="ij")
    rays, valid = model.unproject(torch.stack([u, v], dim=-1).double() * step)
    directions = (rays @ rig.ego_from_camera[camera, :3, :3].T).numpy()
    for _ in range(2 if continued else 0):
        directions, valid = _continued(directions, np.asarray(valid))
    length = np.maximum(np.linalg.norm(directions, axis=-1, keepdims=True), 1.0)
    return (directions / length * UNIT).round().astype(np.int16)


def _continued(directions: np.ndarray, valid: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the entries with those beside the lens's field of view continued linearly from their neighbours in it."""
    total, count = np.zeros_like(directions), np.zeros(valid.shape)
    for axis in (0, 1):
        for side in (1, -1):
            near, far = (np.roll(directions, side * by, axis) for by in (1, 2))
            known = np.roll(valid, side, axis) & np.roll(valid, 2 * side, axis)
            ends = [slice(None)] * 2
            ends[axis] = slice(0, 2) if side > 0 else slice(-2, None)
            known[tuple(ends)] = False  # np.roll took them from the other end
            total += np.where(known[..., None], 2 * near - far, 0)
            count += known
    new = ~valid & (count > 0)
    mean = total / np.maximum(count, 1)[..., None]
    return np.where(new[..., None], mean, directions), valid | new


def _angle_deg(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    second = second / np.linalg.norm(second, axis=-1, keepdims=True)
    return np.degrees(2 * np.arcsin(np.clip(np.linalg.norm(first - second, axis=-1) / 2, 0, 1)))
