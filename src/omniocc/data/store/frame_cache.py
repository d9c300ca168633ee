"""Predictions of a trained stage for every recorded frame, computed once.

Sizes of a frame at preset=tiny:

| array      | bits           | kB |
| ---------- | -------------- | -- |
| candidates | 1 per voxel    | 6  |
| evidence   | 8 per voxel    | 51 |
| ranges     | 16 per pixel   | 18 |

Every scene has one file, and every frame is one row of it: the packed array, then its CRC-32. A file is written whole
or not at all.
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
FINGERPRINT_DIGITS = 12
"""Number of hexadecimal digits of a scene's fingerprint in its file name."""


class FrameCache(ABC):
    """Arrays of one shape, one per frame, in a file for each scene.

    Args:
        folder: folder of the files; its name must depend on everything that the arrays depend on.
        shape: shape of every array.
        data_fingerprint: fingerprint of the data set; scenes without a fingerprint of their own take it. File names
            then hold fingerprints, so that several data sets can share the folder. None: the folder is for one data
            set, and file names hold only the names of scenes.
    """

    BITS: ClassVar[int]
    """Number of bits of one element of an array."""

    def __init__(self, folder: Path, shape: Sequence[int], data_fingerprint: str | None = None):
        self.folder, self.data_fingerprint = folder, data_fingerprint
        self.shape = tuple(shape)
        # -(-n // 8) rounds up: the bits of the last byte may be unused
        self._row_bytes = -(-self.BITS * math.prod(self.shape) // 8) + _CRC_BYTES

    @abstractmethod
    def pack(self, array: Tensor) -> bytes:
        """Return the bytes of one array, without CRC."""

    @abstractmethod
    def unpack(self, payload: bytes) -> Tensor:
        """Return the array that `pack` made these bytes from."""

    def path(self, scene: SceneFrames) -> Path:
        """Return the file of a scene."""
        if self.data_fingerprint is None:
            return self.folder / f"{scene.name}.frames"
        fingerprint = getattr(scene, "fingerprint", self.data_fingerprint)
        return self.folder / f"{scene.name}-{fingerprint[:FINGERPRINT_DIGITS]}.frames"

    def missing(self, scenes: Sequence[SceneFrames]) -> list[SceneFrames]:
        """Return the scenes whose file is absent or of the wrong size."""
        return [scene for scene in scenes if self._file_bytes(scene) != self._row_bytes * len(scene)]

    def write(self, scene: SceneFrames, arrays: Sequence[Tensor]) -> None:
        """Write the arrays of all frames of a scene, in order; raise DataError if the file cannot be written."""
        payloads = [self.pack(array) for array in arrays]
        rows = (payload + zlib.crc32(payload).to_bytes(_CRC_BYTES, "little") for payload in payloads)
        atomic_write(self.path(scene), b"".join(rows))

    def read(self, scene: SceneFrames, frame: int) -> Tensor:
        """Return the array of one frame; raise DataError when the file is missing, too short or damaged."""
        path = self.path(scene)
        try:
            with path.open("rb") as file:
                file.seek(frame * self._row_bytes)
                row = file.read(self._row_bytes)
        except OSError as error:
            raise DataError(f"{path} cannot be read ({error.strerror}); run train.py again to recreate it") from error
        payload, crc = row[:-_CRC_BYTES], row[-_CRC_BYTES:]
        if len(row) != self._row_bytes or zlib.crc32(payload).to_bytes(_CRC_BYTES, "little") != crc:
            raise DataError(f"{path}: frame {frame} is damaged; delete the file and run train.py again")
        return self.unpack(payload)

    def _file_bytes(self, scene: SceneFrames) -> int:
        """Return the size of a scene's file in bytes; -1 if there is none."""
        path = self.path(scene)
        return path.stat().st_size if path.is_file() else -1


class CandidateCache(FrameCache):
    """Candidate voxels, one bit each."""

    BITS = 1

    def pack(self, array: Bool[Tensor, "X Y Z"]) -> bytes:
        """Return the bytes of voxels (X, Y, Z), eight voxels in a byte."""
        return np.packbits(array.cpu().numpy().reshape(-1)).tobytes()

    def unpack(self, payload: bytes) -> Bool[Tensor, "X Y Z"]:
        """Return the voxels (X, Y, Z) of one frame."""
        bits = np.unpackbits(np.frombuffer(payload, dtype=np.uint8), count=math.prod(self.shape))
        return torch.from_numpy(bits.reshape(self.shape).astype(bool))


class EvidenceCache(FrameCache):
    """Evidence of a sketch for every voxel, one byte each; see `omniocc.model.ops.evidence.pack_evidence`."""

    BITS = 8

    def pack(self, array: UInt8[Tensor, "X Y Z"]) -> bytes:
        """Return the bytes of voxels (X, Y, Z), one byte per voxel."""
        return array.cpu().numpy().tobytes()

    def unpack(self, payload: bytes) -> UInt8[Tensor, "X Y Z"]:
        """Return the voxels (X, Y, Z) of one frame."""
        return torch.from_numpy(np.frombuffer(payload, dtype=np.uint8).reshape(self.shape).copy())


class RangeCache(FrameCache):
    """Predicted range panoramas, in steps of 1/256 m; nan: no prediction."""

    BITS = 16

    def pack(self, array: Float32[Tensor, "h w"]) -> bytes:
        """Return the bytes of ranges (h, w), m, 16 bits per pixel, as recordings store ranges."""
        return quantize_range(array.cpu().numpy()).astype("<u2").tobytes()

    def unpack(self, payload: bytes) -> Float32[Tensor, "h w"]:
        """Return the ranges (h, w) of one frame, m."""
        return torch.from_numpy(restore_range(np.frombuffer(payload, dtype="<u2").reshape(self.shape)))
