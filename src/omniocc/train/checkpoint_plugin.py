"""Lightning's plugin that writes and reads checkpoint files as `runs.checkpoint_io` does."""

from pathlib import Path
from typing import Any

from lightning.pytorch.plugins.io import CheckpointIO

from omniocc.runs.checkpoint_io import LAST, previous_of, read_checkpoint, write_checkpoint


class AtomicCheckpointIO(CheckpointIO):
    """Write and read Lightning's checkpoints by the functions of `runs.checkpoint_io`.

    The checkpoint before `last.ckpt` is kept beside it, if this process has read or written it: a damaged one never
    replaces a good one.
    """

    def __init__(self) -> None:
        self._known_good: set[Path] = set()

    def save_checkpoint(self, checkpoint: dict[str, Any], path: Any, storage_options: Any | None = None) -> None:
        """Write a checkpoint; see `write_checkpoint`."""
        if storage_options is not None:
            raise TypeError("checkpoints are files on this machine: storage_options does not apply")
        path = Path(path).absolute()
        keep = path.name == LAST and path in self._known_good
        self._known_good.discard(path)
        write_checkpoint(checkpoint, path, previous_of(path) if keep else None)
        self._known_good.add(path)

    def load_checkpoint(
        self, path: Any, map_location: Any | None = "cpu", weights_only: bool | None = None
    ) -> dict[str, Any]:
        """Read a checkpoint; see `read_checkpoint`."""
        path = Path(path).absolute()
        content = read_checkpoint(path, map_location, weights_only is not False)
        self._known_good.add(path)
        return content

    def remove_checkpoint(self, path: Any) -> None:
        """Remove a checkpoint if it exists."""
        Path(path).unlink(missing_ok=True)
