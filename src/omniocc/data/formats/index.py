"""An index of a dataset's scenes: built once, one small file for each scene, read when the scene is."""

import hashlib
import io
import json
import shutil
from collections.abc import Callable, Mapping
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np

from omniocc.data.formats.arrays import npz_arrays
from omniocc.errors import FAULTS, DataError, moved_by
from omniocc.io import atomic_write, cannot_write, checked_name
from omniocc.lock import locked

NAMES = "scenes.json"


Arrays = TypeVar("Arrays", bound=tuple[Any, ...])  # a NamedTuple of arrays


class Index(Generic[Arrays]):
    """Arrays of every scene by name, in files of their own.

    Args:
        folder: of the index.
        kind: NamedTuple of arrays, one row for each frame.
        build: returns the content of all scenes; called once, by one process.
    """

    def __init__(self, folder: Path, kind: type[Arrays], build: Callable[[], Mapping[str, Arrays]]):
        self.folder, self.build = folder, build
        self.kind: Any = kind

    def __getstate__(self) -> dict[str, Any]:
        """Return the state without what builds the index: processes that read need only the files."""
        return {"folder": self.folder, "kind": self.kind, "build": None}

    def prepare(self) -> None:
        """Build the index if it is missing; other processes wait. A process that is killed leaves nothing behind.

        Raises:
            DataError: from `build`, or when the disk refuses.
            UserError: when no file can have the name of a scene.
        """
        if (self.folder / NAMES).exists():
            return
        with moved_by("data.source.cache"), locked(self.folder.with_suffix(".lock")):
            if not (self.folder / NAMES).exists():
                self._write()

    @cached_property
    def names(self) -> list[str]:
        """Return the names of all scenes, in order; raise DataError before `prepare`."""
        return [name for name, _ in self._listed]

    @cached_property
    def fingerprint(self) -> str:
        """Return a hash of the content."""
        return hashlib.sha256(json.dumps(self._listed).encode()).hexdigest()[:16]

    def read(self, name: str) -> Arrays:
        """Return the arrays of a scene; those of the last scenes are kept."""
        return _read(self.folder / f"{name}.npz", self.kind)

    @cached_property
    def _listed(self) -> list[list[str]]:
        try:
            listed = json.loads((self.folder / NAMES).read_text("utf-8"))
            return [[checked_name("the name of a scene", name), str(sums)] for name, sums in listed]
        except (OSError, *FAULTS) as error:
            raise DataError(f"{self.folder / NAMES}: the index cannot be read ({error}); remove the folder") from error

    def _write(self) -> None:
        found = self.build()
        if not found:
            raise DataError(f"{self.folder}: the dataset has no scenes")
        for name in found:
            checked_name(f"{self.folder}: the name of a scene", name)
        partial = self.folder.with_suffix(".partial")
        shutil.rmtree(partial, ignore_errors=True)
        listed = []
        try:
            partial.mkdir(parents=True)
            for name, arrays in sorted(found.items()):
                stored = io.BytesIO()
                np.savez(stored, **dict(zip(self.kind._fields, arrays, strict=True)))
                atomic_write(partial / f"{name}.npz", stored.getvalue())
                content = b"".join(np.ascontiguousarray(part).tobytes() for part in arrays)
                listed.append([name, hashlib.sha256(content).hexdigest()[:16]])
            shutil.rmtree(self.folder, ignore_errors=True)
            partial.rename(self.folder)
        except DataError:
            raise
        except OSError as error:
            raise cannot_write(self.folder, error) from error
        atomic_write(self.folder / NAMES, json.dumps(listed))


@lru_cache(maxsize=64)
def _read(path: Path, kind: type[Any]) -> Any:
    try:
        return kind(**npz_arrays(path, kind._fields))
    except Exception as error:  # zipfile and numpy have errors of their own
        raise DataError(f"{path}: the index is damaged ({error}); remove the folder {path.parent}") from error
