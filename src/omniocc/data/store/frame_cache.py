"""What a trained stage says about every recorded frame, computed once: candidate voxels as bits, ranges in 16 bits.

One file per scene, one row per frame: the payload, then its CRC-32. A file is written whole or not at all.
"""

import math
import zlib
from abc import ABC, abstractmethod
from collections.abc import Sequence
from pathlib import Path
from typing import Generic, TypeVar

import numpy as np
import torch
from jaxtyping import Bool, Float32
from torch import Tensor

from omniocc.data.store.codec import quantize_range, restore_range
from omniocc.data.store.reader import SceneReader
from omniocc.errors import DataError
from omniocc.io import atomic_write

_CRC_BYTES = 4
Array = TypeVar("Array", bound=Tensor)


class FrameCache(ABC, Generic[Array]):
    """Arrays of one shape, one per frame, in `folder/<scene>.frames`.

    Args:
        folder: its name must say everything that made the arrays.
        shape: of every array.
    """

    def __init__(self, folder: Path, shape: Sequence[int]):
        self.folder = folder
        self.shape = tuple(shape)

    @property
    @abstractmethod
    def payload_bytes(self) -> int:
        """Length of one packed array."""

    @abstractmethod
    def pack(self, array: Array) -> bytes:
        """One array as bytes."""

    @abstractmethod
    def unpack(self, payload: bytes) -> Array:
        """Inverse of `pack`."""

    def path(self, scene: str) -> Path:
        """File of a scene."""
        return self.folder / f"{scene}.frames"

    def missing(self, scenes: Sequence[SceneReader]) -> list[SceneReader]:
        """Scenes that are not there, or whose file has another length than its frames need."""
        row = self.payload_bytes + _CRC_BYTES
        return [
            s for s in scenes if not self.path(s.name).is_file() or self.path(s.name).stat().st_size != row * len(s)
        ]

    def write(self, scene: str, arrays: Sequence[Array]) -> None:
        """All frames of a scene, in order.

        Raises:
            DataError: when the disk refuses.
        """
        payloads = [self.pack(array) for array in arrays]
        rows = (payload + zlib.crc32(payload).to_bytes(_CRC_BYTES, "little") for payload in payloads)
        atomic_write(self.path(scene), b"".join(rows))

    def read(self, scene: str, frame: int) -> Array:
        """One frame.

        Raises:
            DataError: when the file is missing, too short or damaged.
        """
        path, row = self.path(scene), self.payload_bytes + _CRC_BYTES
        try:
            with path.open("rb") as file:
                file.seek(frame * row)
                blob = file.read(row)
        except OSError as error:
            raise DataError(f"{path} cannot be read ({error.strerror}); run train.py again to make it anew") from error
        payload, crc = blob[:-_CRC_BYTES], blob[-_CRC_BYTES:]
        if len(blob) != row or zlib.crc32(payload).to_bytes(_CRC_BYTES, "little") != crc:
            raise DataError(f"{path}: frame {frame} is damaged; delete the file and run train.py again")
        return self.unpack(payload)

    def _size(self, scene: str) -> int:
        path = self.path(scene)
        return path.stat().st_size if path.is_file() else -1


class CandidateCache(FrameCache[Bool[Tensor, "X Y Z"]]):
    """Candidate voxels, one bit each."""

    @property
    def payload_bytes(self) -> int:
        """One bit per cell, rounded up."""
        return -(-math.prod(self.shape) // 8)

    def pack(self, array: Bool[Tensor, "X Y Z"]) -> bytes:
        """Eight cells to a byte."""
        return np.packbits(array.cpu().numpy().reshape(-1)).tobytes()

    def unpack(self, payload: bytes) -> Bool[Tensor, "X Y Z"]:
        """Cells of one frame."""
        bits = np.unpackbits(np.frombuffer(payload, dtype=np.uint8), count=math.prod(self.shape))
        return torch.from_numpy(bits.reshape(self.shape).astype(bool))


class RangeCache(FrameCache[Float32[Tensor, "h w"]]):
    """Predicted panoramas of range in steps of 1/256 m; nan where nothing is known."""

    @property
    def payload_bytes(self) -> int:
        """Two bytes per pixel."""
        return 2 * math.prod(self.shape)

    def pack(self, array: Float32[Tensor, "h w"]) -> bytes:
        """16 bits per pixel, as in the recording."""
        return quantize_range(array.cpu().numpy()).astype("<u2").tobytes()

    def unpack(self, payload: bytes) -> Float32[Tensor, "h w"]:
        """Ranges of one frame, m."""
        return torch.from_numpy(restore_range(np.frombuffer(payload, dtype="<u2").reshape(self.shape)))
