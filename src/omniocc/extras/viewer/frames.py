"""What a viewer shows: frames with their truth, and the predictions of some models for them."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float32, Float64, Int64, UInt8
from torch import Tensor

from omniocc.camera import Equirectangular, Rig
from omniocc.classes import ClassTable
from omniocc.data.source import LidarScan
from omniocc.geometry import Grid


@dataclass(frozen=True, eq=False)
class FramePrediction:
    """The prediction of one model for one frame.

    Attributes:
        labels: class of every cell, 0 free.
        grid: of the labels.
        candidates: cells that the sketch chose; None if it is not known.
        range_m: the depth network's panorama, m, nan where it predicts no range; None without one.
        panorama: directions of that panorama; None without one.
        pixel_labels: classes of the pixels of every camera by the 2D head, (h, w) uint8 each: 0 sky, 255 outside of the
            mask. A map covers the whole image, in fewer pixels. None without such a head.
        figures: scores of this frame alone, nan where nothing counts: `rayiou`, `rayiou@1`, `rayiou@2`, `rayiou@4`,
            `lidar/rayiou`, `iou` and `miou`; those that the frame has the truth for.
    """

    labels: UInt8[Tensor, "X Y Z"]
    grid: Grid
    candidates: Bool[Tensor, "X Y Z"] | None
    range_m: Float32[Tensor, "h w"] | None = None
    panorama: Equirectangular | None = None
    pixel_labels: tuple[np.ndarray, ...] | None = None
    figures: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class ShownFrame:
    """One frame: what the sensors recorded, the truth, and the predictions.

    Attributes:
        scene: name of the scene; any text, also characters that HTML or file systems treat in a special way.
        frame: name of the frame in its scene, such as `000012`.
        time_s: time since the scene began, s.
        images: (H, W, 3) uint8 RGB of every camera, in the rig's order; empty if they are not known.
        rig: the cameras, at the sizes of the images; None if they are not known.
        world_from_ego: pose; None if it is not known.
        truth: true class of every cell, 255 unknown, for every grid of the predictions; without those that have none.
        range_m: true panorama of range, m, inf for sky, nan unknown; None without one.
        panorama: directions of that panorama; None without one.
        lidar: the LiDAR's rays and their hits; None without a LiDAR.
        predictions: by name of the model, in the order of `Shown.models`.
        evidence: returns for a grid what was measured of every cell (`omniocc.data.labels.voxels.cell_evidence`); None
            if the truth was not voted by recorded points.
    """

    scene: str
    frame: str
    time_s: float
    images: tuple[np.ndarray, ...]
    rig: Rig | None
    world_from_ego: Float64[np.ndarray, "4 4"] | None = None
    truth: Mapping[Grid, UInt8[Tensor, "X Y Z"]] = field(default_factory=dict)
    range_m: Float32[Tensor, "h w"] | None = None
    panorama: Equirectangular | None = None
    lidar: LidarScan | None = None
    predictions: Mapping[str, FramePrediction] = field(default_factory=dict)
    evidence: Callable[[Grid], Int64[Tensor, "3 X Y Z"]] | None = None


@dataclass(frozen=True, eq=False)
class Shown:
    """All frames to show, and the facts that they have in common; iterating computes the frames one by one.

    Attributes:
        classes: of voxels, pixels and LiDAR hits.
        models: names of the models, unique; empty where only scenes are shown.
        grids: of the predictions and of the truth; the first model's first.
        road_z_m: height of the road in the ego frame, m, where the rig of a frame states none; None: not known.
        frame_interval_s: time between frames, s.
        directions: unit rays of RayIoU, ego frame, which start in the ego origin.
        source: where the frames come from, in words.
        fingerprint: equal for equal data.
        frames: scene and name of every frame, in the order in which they are shown.
        read: returns the frames, in that order.
    """

    classes: ClassTable
    models: tuple[str, ...]
    grids: tuple[Grid, ...]
    road_z_m: float | None
    frame_interval_s: float
    directions: Float64[Tensor, "R 3"]
    source: str
    fingerprint: str
    frames: tuple[tuple[str, str], ...]
    read: Callable[[], Iterator[ShownFrame]]

    def __len__(self) -> int:
        return len(self.frames)

    def __iter__(self) -> Iterator[ShownFrame]:
        return self.read()
