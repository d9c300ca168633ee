"""Voxel labels of a geometry, voted once from the recorded points and kept beside the scenes."""

import shutil
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

import numpy as np
import torch
import zstandard
from jaxtyping import Int64, UInt8
from torch import Tensor

from omniocc.classes import NUM_CLASSES, UNKNOWN
from omniocc.data.labels.observed import OBSERVED_VERSION, observed
from omniocc.data.recording.pool import Report, make_scenes
from omniocc.data.store.codec import decode_points
from omniocc.data.store.reader import SceneReader
from omniocc.data.store.shard import SHARD_LIMIT_BYTES, SceneWriter, digest
from omniocc.errors import DataError
from omniocc.geometry import Grid
from omniocc.io import atomic_write
from omniocc.progress import Progress

VOTE_VERSION = 1
"""Raise it when the same points would give other voxels."""

MEMBER = "voxels.zst"

Unknown = Literal["free", "unobserved"]
"""What a cell without points is: free, as in the paper, or unknown (255) unless a sensor saw through it."""


def geometry_hash(geometry: Grid, unknown: Unknown = "free") -> str:
    """Short hash of the grid and of the way cells are labelled."""
    how = [repr(geometry), VOTE_VERSION]
    return digest(how if unknown == "free" else [*how, unknown, OBSERVED_VERSION])[:12]


def vote(scene: SceneReader, frame: int, geometry: Grid, unknown: Unknown = "free") -> UInt8[Tensor, "X Y Z"]:
    """Labels of every cell of one frame, from its points."""
    points_m, labels = decode_points(scene.read(frame, ["points.zst"])["points.zst"])
    cells = geometry.voxelize(torch.from_numpy(points_m), torch.from_numpy(labels))
    if unknown == "unobserved":
        cells[observed(scene, frame, geometry) == 0] = UNKNOWN
    return cells


class VoxelCache:
    """Voxels of many scenes in one geometry, as scene folders of their own with one member per frame.

    Args:
        folder: of the dataset; the cache is its subfolder `voxels-<hash of the geometry>`.
        geometry: the grid.
        unknown: what cells without points are.
    """

    def __init__(self, folder: Path, geometry: Grid, unknown: Unknown = "free"):
        if unknown not in get_args(Unknown):
            raise ValueError(f"unknown must be one of {', '.join(get_args(Unknown))}, got {unknown!r}")
        self.folder = Path(folder) / f"voxels-{geometry_hash(geometry, unknown)}"
        self.geometry = geometry
        self.unknown: Unknown = unknown
        self._cached: dict[str, SceneReader] = {}

    def prepare(self, scenes: Sequence[SceneReader], workers: int) -> None:
        """Vote for the scenes that are not there yet or whose cache cannot be opened.

        Raises:
            DataError: when recorded points are damaged or the disk refuses.
        """
        wanted = [scene for scene in scenes if not self._opens(scene)]
        if not wanted:
            return
        work = VoteJob({scene.name: scene.folder for scene in wanted}, self.geometry, self.unknown)
        with Progress(f"voxels {self.folder.name}", sum(map(len, wanted))) as progress:
            make_scenes(work, [self.folder / scene.name for scene in wanted], workers, progress)

    def read(self, scene: SceneReader, frame: int) -> UInt8[Tensor, "X Y Z"]:
        """Labels of one frame; a damaged cache costs a warning and a new vote, never a wrong label."""
        try:
            cached = self._cached.setdefault(scene.name, SceneReader(self.folder / scene.name))
            blob = cached.read(frame, [MEMBER])[MEMBER]
        except DataError as error:
            warnings.warn(f"voxels are voted anew: {error}", stacklevel=2)
            return vote(scene, frame, self.geometry, self.unknown)
        cells = np.frombuffer(bytearray(zstandard.ZstdDecompressor().decompress(blob)), dtype=np.uint8)
        return torch.from_numpy(cells).reshape(self.geometry.shape)

    def counts(self, scenes: Sequence[SceneReader], fingerprint: str) -> Int64[Tensor, "C X Y Z"]:
        """How often each class stood in each cell; unknown is not counted.

        Args:
            scenes: what is counted.
            fingerprint: of the data; what is counted once is kept under it.
        """
        path = self.folder / f"counts-{digest([fingerprint, [scene.name for scene in scenes]])[:12]}.zst"
        shape = (NUM_CLASSES, *self.geometry.shape)
        if path.exists():
            try:
                raw = zstandard.ZstdDecompressor().decompress(path.read_bytes())
                return torch.from_numpy(np.frombuffer(bytearray(raw), dtype="<i8").astype(np.int64)).reshape(shape)
            except (zstandard.ZstdError, ValueError, RuntimeError) as error:
                warnings.warn(f"{path} is damaged ({error}); it is counted anew", stacklevel=2)
        counts = torch.zeros(shape, dtype=torch.int64)
        for scene in scenes:
            for frame in range(len(scene)):
                labels = self.read(scene, frame).flatten().long()
                known = labels < NUM_CLASSES
                counts.view(-1)[(labels * len(labels) + torch.arange(len(labels)))[known]] += 1
        compressor = zstandard.ZstdCompressor(level=3, write_checksum=True)
        atomic_write(path, compressor.compress(counts.numpy().astype("<i8").tobytes()))
        return counts

    def _opens(self, scene: SceneReader) -> bool:
        folder = self.folder / scene.name
        cached = SceneReader(folder)
        if not folder.exists():
            return False
        try:
            return len(cached.index["frames"]) == len(scene)
        except DataError as error:
            warnings.warn(f"voxels are voted anew: {error}", stacklevel=2)
            shutil.rmtree(folder)
            return False


@dataclass(frozen=True)
class VoteJob:
    """Makes the voxels of one scene folder after another; can be sent to other processes.

    Attributes:
        sources: folder of each scene's recording by name.
        geometry: the grid.
        unknown: what cells without points are.
    """

    sources: dict[str, Path | str]
    geometry: Grid
    unknown: Unknown

    def __call__(self, folder: Path, report: Report) -> None:
        """Vote for every frame that is missing, then seal the folder."""
        writer = SceneWriter(folder, SHARD_LIMIT_BYTES)
        scene = SceneReader(self.sources[folder.name])
        try:
            report(len(scene) if writer.finished else writer.num_frames)
            if writer.finished:
                return
            for frame in range(writer.num_frames, len(scene)):
                cells = vote(scene, frame, self.geometry, self.unknown).contiguous().numpy()
                writer.append({MEMBER: zstandard.ZstdCompressor(level=3).compress(cells.tobytes())}, {})
                report(1)
            writer.finish({"geometry": repr(self.geometry), "vote": VOTE_VERSION, "unknown": self.unknown})
        finally:
            writer.close()
