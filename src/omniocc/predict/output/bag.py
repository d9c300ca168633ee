"""Predictions as messages of a ROS bag: what they hold, read back from the files of the frames.

The bag is written after the frames, from their files, and renamed when it is whole. So a stop costs no prediction: the
same command skips the finished frames and writes the bag anew.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float32, UInt8

from omniocc.classes import FREE, UNKNOWN
from omniocc.data.formats.arrays import npz_arrays
from omniocc.errors import UserError
from omniocc.predict.input.sequence import FrameSequence, Mount
from omniocc.predict.output.range_files import POINTS, RANGES, VERTEX
from omniocc.predict.output.voxel_files import VOXELS, read_voxels

SUFFIX = ".mcap"


class BagFrame(NamedTuple):
    """One predicted frame.

    Attributes:
        stamp_ns: its time.
        points_m: centres of the occupied cells, or the points of the ranges, in the ego frame.
        colors: RGB of the points.
        labels: their classes; None for ranges.
        range_m: panorama, nan where there is no answer; None for a sketch without depth.
    """

    stamp_ns: int
    points_m: Float32[np.ndarray, "P 3"]
    colors: UInt8[np.ndarray, "P 3"]
    labels: UInt8[np.ndarray, " P"] | None
    range_m: Float32[np.ndarray, "h w"] | None


class BagContent(NamedTuple):
    """What a bag of predictions holds.

    Attributes:
        mount: where the ego frame is.
        panorama_z_m: height of the panorama's origin in the ego frame.
        frames: read one at a time.
        total: number of them.
    """

    mount: Mount
    panorama_z_m: float
    frames: Iterable[BagFrame]
    total: int


class Bags(NamedTuple):
    """What reads and writes bags; the scripts hand it in, see `omniocc.predict.input.own`.

    Attributes:
        read: see `omniocc.predict.input.own.ReadBag`.
        replaceable: returns whether an existing file is a bag of predictions.
        write: writes a bag, whole or not at all.
    """

    read: Callable
    replaceable: Callable[[Path], bool]
    write: Callable[[Path, BagContent], None]


def bag_path(name: str | None, bags: Bags | None) -> Path | None:
    """Return the path of the bag to write; None: none is asked for.

    Raises:
        UserError: when it has another suffix, or a file is there that is no bag of predictions.
    """
    if name is None:
        return None
    path = Path(name)
    if bags is None:
        raise UserError(f"write_bag={name}: bags are written by the command src/predict.py alone")
    if path.suffix != SUFFIX:
        raise UserError(f"write_bag={name}: the name of the bag ends with {SUFFIX}")
    if path.exists() and not bags.replaceable(path):
        raise UserError(f"write_bag={name}: this file holds something other than predictions; choose another name")
    return path


def run_into_bag(
    run: Callable[[], None], path: Path | None, bags: Bags | None, content: Callable[[], BagContent]
) -> None:
    """Run predictions, then write the bag; after an error too, of the frames that are finished."""

    def write() -> None:
        if path is not None and bags is not None and (made := content()).total:
            bags.write(path, made)

    try:
        run()
    except (UserError, OSError):  # of one frame, such as a damaged image
        write()
        raise
    write()


def voxels_of(output: Path, sequence: FrameSequence) -> BagContent:
    """Return the content for the finished frames of a sequence, whose folders of voxels are in `output`."""
    done = _finished(output, sequence, VOXELS, sequence.wanted)

    def frames() -> Iterator[BagFrame]:
        for frame, path in done:
            voxels = read_voxels(path)
            occupied = (voxels.labels != FREE) & (voxels.labels != UNKNOWN)
            labels = voxels.labels[occupied].numpy()
            points_m = voxels.geometry.centers(torch.float64)[occupied].float().numpy()
            colors = voxels.classes.palette[labels]
            yield BagFrame(sequence.stamps_ns[frame], points_m, colors, labels, voxels.range_m)

    return BagContent(sequence.mount, sequence.origin_z_m, frames(), len(done))


def ranges_of(output: Path, sequence: FrameSequence, total: int) -> BagContent:
    """Return the content for the first `total` frames of a sequence, whose folders of ranges are in `output`."""
    done = _finished(output, sequence, POINTS, range(total))

    def frames() -> Iterator[BagFrame]:
        for frame, path in done:
            table = np.frombuffer(path.read_bytes().partition(b"end_header\n")[2], VERTEX)
            points_m = np.stack([table[axis] for axis in "xyz"], axis=1)
            colors = np.stack([table[color] for color in ("red", "green", "blue")], axis=1)
            range_m = npz_arrays(path.with_name(RANGES), ["range_m"])["range_m"]
            yield BagFrame(sequence.stamps_ns[frame], points_m, colors, None, range_m)

    return BagContent(sequence.mount, 0.0, frames(), len(done))


def _finished(output: Path, sequence: FrameSequence, name: str, frames: Sequence[int]) -> list[tuple[int, Path]]:
    """Return the numbers of those frames that are finished, and the file that marks each, in the order of time."""
    paths = [output / sequence.name / frame / name for frame in sequence.frame_names]
    done = [(frame, paths[frame]) for frame in frames if paths[frame].is_file()]
    return sorted(done, key=lambda one: sequence.stamps_ns[one[0]])
