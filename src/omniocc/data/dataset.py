"""Windows of frames as training samples."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Bool, Float32, Float64, Int64, UInt8
from torch import Tensor
from torch.utils.data import Dataset

from omniocc.batch import Batch
from omniocc.camera import Rig
from omniocc.classes import UNKNOWN
from omniocc.data.origins import Origins, choose_origins
from omniocc.data.rays import rays_around
from omniocc.data.source import SceneFrames, VoxelLabels
from omniocc.data.store.frame_cache import CandidateCache, EvidenceCache, FrameCache, RangeCache
from omniocc.geometry import Grid
from omniocc.loss import RayWindow

NAN = float("nan")
SCAN_FIELDS = ("scan_origins", "scan_ends", "scan_labels")
FILL_VALUES: dict[str, float | bool] = {
    "images": 0,
    "voxels": UNKNOWN,
    "own_voxels": UNKNOWN,
    "scored": True,
    "ray_origins": NAN,
    "ray_times": 0,
    "pixel_labels": UNKNOWN,
    "lidar_range_m": float("inf"),
    "lidar_labels": UNKNOWN,
    "lidar_directions": 0.0,
    "lidar_origins": 0.0,
    "lidar_moving": False,
    "scan_origins": NAN,
    "scan_ends": NAN,
    "scan_labels": UNKNOWN,
    "erp_range_m": NAN,
    "camera_range_m": NAN,
}
"""What a batch holds where a sample has no value or ends sooner than others: it gives no loss and no score."""


class Sample(NamedTuple):
    """One window; fields as in `omniocc.batch.Batch`, without the axis of samples."""

    images: UInt8[Tensor, "T N 3 H W"]
    rigs: tuple[Rig, ...]
    world_from_ego: Float64[Tensor, "T 4 4"]
    frame_id: str
    voxels: UInt8[Tensor, "X Y Z"] | None = None
    own_voxels: UInt8[Tensor, "U V W"] | None = None
    scored: Bool[Tensor, "U V W"] | None = None
    ray_origins: Float32[Tensor, "O 3"] | None = None
    ray_times: Int64[Tensor, " O"] | None = None
    pixel_labels: UInt8[Tensor, "N H W"] | None = None
    lidar_range_m: Float32[Tensor, " R"] | None = None
    lidar_labels: UInt8[Tensor, " R"] | None = None
    lidar_directions: Float32[Tensor, "R 3"] | None = None
    lidar_origins: Float32[Tensor, "R 3"] | None = None
    lidar_moving: Bool[Tensor, " R"] | None = None
    scan_origins: Float32[Tensor, "S 3"] | None = None
    scan_ends: Float32[Tensor, "S 3"] | None = None
    scan_labels: UInt8[Tensor, " S"] | None = None
    erp_range_m: Float32[Tensor, "h w"] | None = None
    camera_range_m: Float32[Tensor, "N H W"] | None = None
    depth_range_m: Float32[Tensor, "h w"] | None = None
    candidates: Bool[Tensor, "T X Y Z"] | None = None
    evidence: UInt8[Tensor, "T X Y Z"] | None = None
    exists: Bool[Tensor, " T"] | None = None


class Needs(NamedTuple):
    """The parts of a sample that are used; nothing else is read and decoded.

    Attributes:
        images: images of all frames of the window; if false, the sample's `images` have no cameras.
        voxels: class of every cell in the newest frame.
        pixel_labels: classes of the newest frame's pixels.
        scores: the newest frame's LiDAR scan, truth on the dataset's own grid, and starts of RayIoU's rays.
        panorama: true ranges around the newest frame's ego origin.
        camera_ranges: true range of the newest frame's pixels.
        depth: panorama that the depth stage predicted for the newest frame.
        candidates: voxels that the sketch stage chose in every frame of the window.
        evidence: what the sketch stage knows of every voxel in every frame of the window.
        votes: labels that are read as `voxels`; None: those of the source.
        rays: measured rays of the newest frame and its neighbours; None: no rays.
    """

    images: bool = True
    voxels: bool = True
    pixel_labels: bool = True
    scores: bool = True
    panorama: bool = False
    camera_ranges: bool = False
    depth: RangeCache | None = None
    candidates: CandidateCache | None = None
    evidence: EvidenceCache | None = None
    votes: VoxelLabels | None = None
    rays: RayWindow | None = None


class WindowDataset(Dataset):
    """Every recorded frame once, as the newest of a window of T consecutive frames of its scene.

    Frames before a scene's first are replaced by the first, and marked as missing in `exists`.

    Args:
        scenes: scenes whose frames are the samples, in order.
        voxels: labels of the grid.
        window: T.
        needs: parts of the samples to read.
        own_rays: whether the LiDAR's rays differ from frame to frame, so that every sample holds them.
        origins: where the rays of RayIoU start.
        scored_grid: grid of the scores, within which `origins="trajectory"` looks for starts.

    Raises:
        ValueError: if the window is shorter than 1 frame, or `origins="trajectory"` has no `scored_grid`.
    """

    def __init__(
        self,
        scenes: Sequence[SceneFrames],
        voxels: VoxelLabels,
        window: int,
        needs: Needs = Needs(),  # noqa: B008 - immutable
        own_rays: bool = False,
        origins: Origins = "own",
        scored_grid: Grid | None = None,
    ):
        if window < 1:
            raise ValueError(f"window must be at least 1 frame, got {window}")
        if origins == "trajectory" and scored_grid is None:
            raise ValueError("origins='trajectory' needs scored_grid, the grid of the scores")
        self.scenes = tuple(scenes)
        self.voxels = voxels
        self.window = window
        self.needs = needs
        self.own_rays = own_rays
        self.origins: Origins = origins
        self.scored_grid = scored_grid
        self._ends = np.cumsum([len(scene) for scene in self.scenes])

    def __len__(self) -> int:
        return int(self._ends[-1]) if len(self._ends) else 0

    def locate(self, index: int) -> tuple[SceneFrames, int]:
        """Return scene and frame number of a sample's newest frame; raise IndexError beyond the last sample."""
        if not 0 <= index < len(self):
            raise IndexError(f"sample {index} of {len(self)}")
        scene = int(np.searchsorted(self._ends, index, side="right"))
        return self.scenes[scene], index - (int(self._ends[scene - 1]) if scene else 0)

    def __getitem__(self, index: int) -> Sample:
        scene, newest = self.locate(index)
        frames, needs = window_frames(newest, self.window), self.needs
        labels = scene.pixel_labels(newest) if needs.pixel_labels else None
        # a disturbed rig does not change which cells were observed
        labelled = getattr(scene, "undisturbed", scene)
        panorama = scene.erp_range_m(newest) if needs.panorama else None
        ranges = scene.camera_range_m(newest) if needs.camera_ranges else None
        ranges = ranges and [mark_unmeasured(range_m) for range_m in ranges]
        return Sample(
            images=read_window(scene, frames) if needs.images else torch.zeros(self.window, 0, 3, 1, 1).byte(),
            rigs=tuple(scene.rigs[frame] for frame in frames),
            world_from_ego=torch.from_numpy(scene.world_from_ego[frames]),
            frame_id=f"{scene.name}/{newest:06d}",
            voxels=(needs.votes or self.voxels).read(labelled, newest) if needs.voxels else None,
            **({} if needs.rays is None else read_rays(labelled, newest, needs.rays)),
            **(self._read_benchmark(scene, newest) if needs.scores else {}),
            pixel_labels=None if labels is None else stack_cameras(labels, FILL_VALUES["pixel_labels"]),
            **(self._read_lidar(scene, newest) if needs.scores else {}),
            erp_range_m=None if panorama is None else torch.from_numpy(mark_unmeasured(panorama)),
            camera_range_m=None if ranges is None else stack_cameras(ranges, FILL_VALUES["camera_range_m"]),
            depth_range_m=needs.depth and needs.depth.read(scene, newest),
            candidates=needs.candidates and read_frames(needs.candidates, scene, frames),
            evidence=needs.evidence and read_frames(needs.evidence, scene, frames),
            exists=torch.arange(newest - self.window + 1, newest + 1) >= 0,
        )

    def _read_benchmark(self, scene: SceneFrames, frame: int) -> dict[str, Tensor | None]:
        truth = self.voxels.benchmark(scene, frame)
        parts = {} if truth is None else {"own_voxels": truth.voxels, "scored": truth.scored}
        own = None if truth is None else truth.ray_origins
        origins = choose_origins(self.origins, own, scene, frame, self.scored_grid)
        if origins is not None:
            parts |= {"ray_origins": origins.positions_m.float(), "ray_times": origins.times}
        return parts

    def _read_lidar(self, scene: SceneFrames, frame: int) -> dict[str, Tensor]:
        scan = scene.lidar(frame)
        if scan is None:
            return {}
        parts = {"lidar_range_m": scan.range_m, "lidar_labels": scan.labels}
        parts |= {} if scan.moving is None else {"lidar_moving": scan.moving}
        if self.own_rays:
            origins = np.zeros_like(scan.directions) if scan.origins is None else scan.origins
            parts |= {"lidar_directions": scan.directions, "lidar_origins": origins}
        return {name: torch.from_numpy(part) for name, part in parts.items()}


def read_rays(scene: SceneFrames, frame: int, window: RayWindow) -> dict[str, Tensor]:
    """Return the fields of a sample with the measured rays of a frame and its neighbours; none without scans."""
    rays = rays_around(scene, frame, window)
    return {} if rays is None else dict(zip(SCAN_FIELDS, (part[0] for part in rays), strict=True))


def mark_unmeasured(range_m: Float32[np.ndarray, "h w"]) -> Float32[np.ndarray, "h w"]:
    """Return ranges, m, with nan where nothing came back, which some sources write as 0 or -1."""
    return np.where(range_m > 0, range_m, np.float32(np.nan)) if (range_m <= 0).any() else range_m


def window_frames(newest: int, window: int) -> list[int]:
    """Return the numbers of the frames of a window, oldest first; never before the scene's first."""
    return [max(0, frame) for frame in range(newest - window + 1, newest + 1)]


def pad_stack(parts: Sequence[Tensor], fill: float | bool) -> Tensor:
    """Stack tensors of one rank and type along a new first axis; smaller ones end in `fill` along every axis."""
    shape = torch.tensor([part.shape for part in parts]).amax(0).tolist()
    if all(list(part.shape) == shape for part in parts):
        return torch.stack(list(parts))
    stacked = parts[0].new_full((len(parts), *shape), fill)
    for row, part in zip(stacked, parts, strict=True):
        row[tuple(slice(size) for size in part.shape)] = part
    return stacked


def stack_cameras(arrays: Sequence[np.ndarray], fill: float | bool) -> Tensor:
    """Stack one array of each camera, padded where their sizes differ."""
    return pad_stack([torch.from_numpy(array) for array in arrays], fill)


def read_images(scene: SceneFrames, frame: int) -> UInt8[Tensor, "N 3 H W"]:
    """Return the images of all cameras in a frame; in memory the channels stay last, as they are decoded."""
    return stack_cameras(scene.images(frame), FILL_VALUES["images"]).permute(0, 3, 1, 2)


def read_window(scene: SceneFrames, frames: Sequence[int]) -> UInt8[Tensor, "T N 3 H W"]:
    """Return the images of some frames, with the channels last in memory; a repeated frame is decoded once."""
    images = {frame: read_images(scene, frame) for frame in set(frames)}
    return channels_first(pad_stack([channels_last(images[frame]) for frame in frames], FILL_VALUES["images"]))


def read_frames(cache: FrameCache, scene: SceneFrames, frames: Sequence[int]) -> Tensor:
    """Return the cached arrays of some frames, stacked."""
    return torch.stack([cache.read(scene, frame) for frame in frames])


def channels_last(images: UInt8[Tensor, "*B C H W"]) -> UInt8[Tensor, "*B H W C"]:
    """Return images with the channels as last axis; nothing is copied."""
    return images.movedim(-3, -1)


def channels_first(images: UInt8[Tensor, "*B H W C"]) -> UInt8[Tensor, "*B C H W"]:
    """Return images with the channels before rows and columns; nothing is copied."""
    return images.movedim(-1, -3)


def collate(samples: Sequence[Sample]) -> Batch:
    """Stack samples along a new first axis; pad where sizes differ, fill where some have no value (see `Batch`)."""
    columns = dict(zip(Sample._fields, zip(*samples, strict=True), strict=True))
    rigs, frame_ids = columns.pop("rigs"), columns.pop("frame_id")
    images = channels_first(pad_stack([channels_last(part) for part in columns.pop("images")], FILL_VALUES["images"]))
    stacked = {name: _stack(column, FILL_VALUES.get(name)) for name, column in columns.items()}
    return Batch(images=images, rigs=rigs, frame_ids=frame_ids, **stacked)  # type: ignore[arg-type]


def _stack(column: Sequence[Tensor | None], fill: float | bool | None) -> Tensor | None:
    present = [value for value in column if value is not None]
    if not present:
        return None
    if fill is None:  # present in all samples, with equal shapes
        return torch.stack(present)
    return pad_stack([torch.full_like(present[0], fill) if value is None else value for value in column], fill)
