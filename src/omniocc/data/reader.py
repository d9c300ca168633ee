"""Reading scene folders: any member of any frame by byte offset, every byte checked."""

import json
import zlib
from collections.abc import Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from omniocc.camera import Rig
from omniocc.data.errors import DataError
from omniocc.data.shard import INDEX, META, SCHEMA, digest, sha256, shard_name

_RIGS: dict[tuple[str, ...], Rig] = {}


class SceneReader:
    """A complete scene. Opens nothing before it is needed and keeps no file open: it can be sent to other processes.

    Args:
        folder: the scene's folder.

    Raises:
        DataError: from every method, when something is missing or damaged; names the file, scene, frame and member.
    """

    def __init__(self, folder: Path):
        self.folder = Path(folder)

    @property
    def name(self) -> str:
        """The scene's name."""
        return self.folder.name

    @cached_property
    def meta(self) -> dict[str, Any]:
        """Schema, facts of the scene, checksums of its files."""
        meta = self._json(META)
        claimed = meta.pop("digest", None)
        if digest(meta) != claimed:
            raise self.damaged(self.folder / META, "its checksum differs")
        if meta["schema"] != SCHEMA:
            raise self.damaged(self.folder / META, f"schema {meta['schema']}, this version reads {SCHEMA}")
        return meta

    @cached_property
    def index(self) -> dict[str, Any]:
        """Names of the members; per frame shard, offsets, sizes, checksums, and what the writer called the entry."""
        if sha256(self._existing(INDEX)) != self.meta["files"][INDEX]["sha256"]:
            raise self.damaged(self.folder / INDEX, "its checksum differs")
        return self._json(INDEX)

    @cached_property
    def world_from_ego(self) -> np.ndarray:
        """(F, 4, 4) float64 pose of every frame."""
        return np.array([frame["entry"]["world_from_ego"] for frame in self.index["frames"]], dtype=np.float64)

    @cached_property
    def time_s(self) -> np.ndarray:
        """(F,) float64 time of every frame since the scene began."""
        return np.array([frame["entry"]["time_s"] for frame in self.index["frames"]], dtype=np.float64)

    @cached_property
    def rig(self) -> Rig:
        """The cameras that recorded the scene; scenes with equal files share one object."""
        facts = self.meta["files"].get("rig.yaml")
        if facts is None or sha256(self._existing("rig.yaml")) != facts["sha256"]:
            raise self.damaged(self.folder / "rig.yaml", "it is missing or its checksum differs")
        key = tuple(entry["sha256"] for name, entry in self.meta["files"].items() if name.startswith("rig."))
        if key not in _RIGS:
            _RIGS[key] = Rig.load(self.folder / "rig.yaml")
        return _RIGS[key]

    def __len__(self) -> int:
        return self.meta["frames"]

    def read(self, frame: int, members: Sequence[str]) -> dict[str, bytes]:
        """The named members of one frame, each compared with its checksum."""
        record = self.index["frames"][frame]
        shard = self.folder / shard_name(record["shard"])
        blobs = {}
        try:
            with shard.open("rb") as file:
                for member in members:
                    at = self._column(member)
                    file.seek(record["offset"][at])
                    blob = file.read(record["size"][at])
                    if len(blob) != record["size"][at]:
                        raise self.damaged(shard, "the file is cut short", frame, member)
                    if zlib.crc32(blob) != record["crc32"][at]:
                        raise self.damaged(shard, "checksum differs", frame, member)
                    blobs[member] = blob
        except FileNotFoundError as error:
            raise self.damaged(shard, "the file is missing", frame, members[0]) from error
        return blobs

    def damaged(self, path: Path, what: str, frame: int | None = None, member: str | None = None) -> DataError:
        """The error for something wrong with `path`, with all that is known and the remedy."""
        where = f", frame {frame}" if frame is not None else ""
        where += f", member '{member}'" if member is not None else ""
        return DataError(
            f"{path}: scene '{self.name}'{where}: {what}. Delete the folder {self.folder} and run the same command "
            "again: only this scene is made anew"
        )

    def __getstate__(self) -> dict[str, Any]:
        return {"folder": self.folder}

    def _column(self, member: str) -> int:
        if member not in self.index["members"]:
            raise self.damaged(
                self.folder / INDEX, f"it has no member '{member}' (it has: {', '.join(self.index['members'])})"
            )
        return self.index["members"].index(member)

    def _existing(self, name: str) -> Path:
        if not (self.folder / name).is_file():
            raise self.damaged(self.folder / name, "the file is missing")
        return self.folder / name

    def _json(self, name: str) -> dict[str, Any]:
        try:
            content = json.loads(self._existing(name).read_bytes())
        except ValueError as error:
            raise self.damaged(self.folder / name, "it is not valid JSON") from error
        if not isinstance(content, dict):
            raise self.damaged(self.folder / name, "it is not a JSON object")
        return content


def find_scenes(folder: Path) -> list[SceneReader]:
    """All complete scenes of a dataset folder, by name."""
    return [SceneReader(path.parent) for path in sorted(Path(folder).glob(f"*/{META}"))]
