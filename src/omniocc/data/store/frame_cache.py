"""Predictions of a trained stage for every recorded frame, computed once.

Candidates take one bit a voxel, evidence eight, ranges 16 bits a pixel: at preset=tiny 6, 51 and 18 kB a frame.

One file per scene, one row per frame: the payload, then its CRC-32. A file is written whole or not at all.
"""

import math
import zlib
from abc import ABC, abstractmethod
from collections.abc import Sequence
from pathlib import Path
from typing import ClassVar

import numpy as np
import torch
from jaxtyping import Bool, Float32, UInt8
from torch import Tensor

from omniocc.data.source import SceneFrames
from omniocc.data.store.codec import quantize_range, restore_range
from omniocc.errors import DataError
from omniocc.io import atomic_write

_CRC_BYTES = 4
DIGITS = 12
"""Digits of a scene's fingerprint in the name of its file."""


class FrameCache(ABC):
    """Arrays of one shape, one per frame, in a file for each scene.

    Args:
        folder: of the files; its name must depend on everything that the arrays depend on.
        shape: of every array.
        data: fingerprint of the data, for scenes that have none of their own; the folder holds scenes of any data.
            None: the folder holds scenes of one dataset, and their names tell them apart.
    """

    BITS: ClassVar[int]
    """Number of bits of one element of an array."""

    def __init__(self, folder: Path, shape: Sequence[int], data: str | None = None):
        self.folder, self.data = folder, data
        self.shape = tuple(shape)
        self._row_bytes = -(-self.BITS * math.prod(self.shape) // 8) + _CRC_BYTES

    @abstractmethod
    def pack(self, array: Tensor) -> bytes:
        """Return one array as bytes."""

    @abstractmethod
    def unpack(self, payload: bytes) -> Tensor:
        """Return the array that bytes hold, the inverse of `pack`."""

    def path(self, scene: SceneFrames) -> Path:
        """Return the file of a scene."""
        if self.data is None:
            return self.folder / f"{scene.name}.frames"
        return self.folder / f"{scene.name}-{getattr(scene, 'fingerprint', self.data)[:DIGITS]}.frames"

    def missing(self, scenes: Sequence[SceneFrames]) -> list[SceneFrames]:
        """Return the scenes that have no file, or one of the wrong length."""
        return [scene for scene in scenes if self._size(scene) != self._row_bytes * len(scene)]

    def write(self, scene: SceneFrames, arrays: Sequence[Tensor]) -> None:
        """Write all frames of a scene, in order; raise DataError when the disk refuses."""
        payloads = [self.pack(array) for array in arrays]
        rows = (payload + zlib.crc32(payload).to_bytes(_CRC_BYTES, "little") for payload in payloads)
        atomic_write(self.path(scene), b"".join(rows))

    def read(self, scene: SceneFrames, frame: int) -> Tensor:
        """Return one frame; raise DataError when the file is missing, too short or damaged."""
        path, row = self.path(scene), self._row_bytes
        try:
            with path.open("rb") as file:
                file.seek(frame * row)
                blob = file.read(row)
        except OSError as error:
            raise DataError(f"{path} cannot be read ({error.strerror}); run train.py again to recreate it") from error
        payload, crc = blob[:-_CRC_BYTES], blob[-_CRC_BYTES:]
        if len(blob) != row or zlib.crc32(payload).to_bytes(_CRC_BYTES, "little") != crc:
            raise DataError(f"{path}: frame {frame} is damaged; delete the file and run train.py again")
        return self.unpack(payload)

    def _size(self, scene: SceneFrames) -> int:
        path = self.path(scene)
        return path.stat().st_size if path.is_file() else -1


class CandidateCache(FrameCache):
    """Candidate voxels, one bit each."""

    BITS = 1

    def pack(self, array: Bool[Tensor, "X Y Z"]) -> bytes:
        """Return the cells (X, Y, Z), eight in a byte."""
        return np.packbits(array.cpu().numpy().reshape(-1)).tobytes()

    def unpack(self, payload: bytes) -> Bool[Tensor, "X Y Z"]:
        """Return the cells of one frame, (X, Y, Z)."""
        bits = np.unpackbits(np.frombuffer(payload, dtype=np.uint8), count=math.prod(self.shape))
        return torch.from_numpy(bits.reshape(self.shape).astype(bool))


class EvidenceCache(FrameCache):
    """What a sketch knows of every voxel, eight bits each, see `omniocc.model.ops.evidence`."""

    BITS = 8

    def pack(self, array: UInt8[Tensor, "X Y Z"]) -> bytes:
        """Return the cells (X, Y, Z), one byte each."""
        return array.cpu().numpy().tobytes()

    def unpack(self, payload: bytes) -> UInt8[Tensor, "X Y Z"]:
        """Return the cells of one frame, (X, Y, Z)."""
        return torch.from_numpy(np.frombuffer(payload, dtype=np.uint8).reshape(self.shape).copy())


class RangeCache(FrameCache):
    """Predicted panoramas of range in steps of 1/256 m; nan where there is no prediction."""

    BITS = 16

    def pack(self, array: Float32[Tensor, "h w"]) -> bytes:
        """Return ranges (h, w), m, with 16 bits per pixel, as in recordings."""
        return quantize_range(array.cpu().numpy()).astype("<u2").tobytes()

    def unpack(self, payload: bytes) -> Float32[Tensor, "h w"]:
        """Return the ranges of one frame, (h, w), m."""
        return torch.from_numpy(restore_range(np.frombuffer(payload, dtype="<u2").reshape(self.shape)))
