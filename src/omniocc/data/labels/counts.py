"""How often each cell has each class: counted over frames, kept on disk."""

import math
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import torch
import zstandard
from jaxtyping import Int64
from torch import Tensor

from omniocc.data.source import SceneFrames, VoxelLabels
from omniocc.data.store.codec import decompress
from omniocc.errors import DataError
from omniocc.io import atomic_write
from omniocc.lock import locked
from omniocc.progress import Progress
from rayiou.labels import ids_beyond

Frames = Sequence[tuple[SceneFrames, int]]


def count_classes(
    labels: VoxelLabels, frames: Frames, num_classes: int, shape: Sequence[int], progress: Progress | None = None
) -> Int64[Tensor, "C X Y Z"]:
    """Return in how many of these frames each cell has each class, unknown excluded, for a grid of this shape.

    Most cells are free (class 0), so the others are counted and the free ones are what is left.

    Raises:
        DataError: naming the frame with a label that is no class.
    """
    counts = torch.zeros(num_classes, math.prod(shape), dtype=torch.int64)
    unknown, read = torch.zeros(math.prod(shape), dtype=torch.int64), 0
    for scene, frame in frames:
        cells = labels.read(scene, frame)
        if cells is not None:
            place = cells.flatten().nonzero().squeeze(1)
            found = cells.flatten()[place]
            if wrong := ids_beyond(found.numpy(), num_classes):
                raise DataError(
                    f"scene '{scene.name}', frame {frame}: its voxels have the classes {wrong}, but the source has "
                    f"0 to {num_classes - 1}, and 255 for unknown"
                )
            label = found.long()
            known = label < num_classes
            counts.view(-1)[label[known] * counts.shape[1] + place[known]] += 1
            unknown[place[~known]] += 1
            read += 1
        if progress is not None:
            progress.advance()
    counts[0] = read - counts.sum(dim=0) - unknown
    return counts.view(num_classes, *shape)


def all_frames(scenes: Sequence[SceneFrames]) -> list[tuple[SceneFrames, int]]:
    """Return every frame of some scenes, with its scene."""
    return [(scene, frame) for scene in scenes for frame in range(len(scene))]


def kept_counts(
    path: Path, shape: Sequence[int], count: Callable[[], Int64[Tensor, "C X Y Z"]]
) -> Int64[Tensor, "C X Y Z"]:
    """Return the counts (C, X, Y, Z) = `shape` in a file; where it is missing or damaged, count and write it."""
    if (counts := _read(path, shape)) is not None:  # without a lock: the folder may be read-only
        return counts
    with locked(path.with_suffix(".lock")):  # of the processes of a run the first counts, the others wait
        counts = _read(path, shape)
        if counts is None:
            counts = count()
            compressor = zstandard.ZstdCompressor(level=3, write_checksum=True)
            atomic_write(path, compressor.compress(counts.numpy().astype("<i8").tobytes()))
    return counts


def _read(path: Path, shape: Sequence[int]) -> Int64[Tensor, "C X Y Z"] | None:
    if not path.is_file():
        return None
    try:
        raw = decompress(path.read_bytes(), 8 * math.prod(shape))
        return torch.from_numpy(np.frombuffer(bytearray(raw), dtype="<i8").astype(np.int64)).reshape(tuple(shape))
    except (zstandard.ZstdError, ValueError, RuntimeError) as error:
        warnings.warn(f"{path} is damaged ({error}); it is counted again", stacklevel=3)
        return None
