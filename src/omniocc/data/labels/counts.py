"""How often each cell has each class: counted over frames, kept on disk."""

import warnings
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import torch
import zstandard
from jaxtyping import Int64
from torch import Tensor

from omniocc.data.source import SceneFrames, VoxelLabels
from omniocc.io import atomic_write
from omniocc.progress import Progress

Frames = Sequence[tuple[SceneFrames, int]]


def count_classes(
    labels: VoxelLabels, frames: Frames, num_classes: int, shape: Sequence[int], progress: Progress | None = None
) -> Int64[Tensor, "C X Y Z"]:
    """Return in how many of these frames each cell has each class, unknown excluded, for a grid of this shape."""
    counts = torch.zeros(num_classes, *shape, dtype=torch.int64)
    for scene, frame in frames:
        cells = labels.read(scene, frame)
        if cells is not None:
            flat = cells.flatten().long()
            known = flat < num_classes
            counts.view(-1)[(flat * len(flat) + torch.arange(len(flat)))[known]] += 1
        if progress is not None:
            progress.advance()
    return counts


def all_frames(scenes: Sequence[SceneFrames]) -> list[tuple[SceneFrames, int]]:
    """Return every frame of some scenes, with its scene."""
    return [(scene, frame) for scene in scenes for frame in range(len(scene))]


def kept_counts(
    path: Path, shape: Sequence[int], count: Callable[[], Int64[Tensor, "C X Y Z"]]
) -> Int64[Tensor, "C X Y Z"]:
    """Return the counts (C, X, Y, Z) = `shape` in a file; where it is missing or damaged, count and write it."""
    if path.exists():
        try:
            raw = zstandard.ZstdDecompressor().decompress(path.read_bytes())
            return torch.from_numpy(np.frombuffer(bytearray(raw), dtype="<i8").astype(np.int64)).reshape(tuple(shape))
        except (zstandard.ZstdError, ValueError, RuntimeError) as error:
            warnings.warn(f"{path} is damaged ({error}); it is counted again", stacklevel=2)
    counts = count()
    compressor = zstandard.ZstdCompressor(level=3, write_checksum=True)
    atomic_write(path, compressor.compress(counts.numpy().astype("<i8").tobytes()))
    return counts
