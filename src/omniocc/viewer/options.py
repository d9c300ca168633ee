"""Options of `view.py`."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from omniocc.errors import UserError


@dataclass(frozen=True)
class ViewOptions:
    """Options of `view.py` that choose what is shown; see `conf/view.yaml`."""

    run: Sequence[str] = ()
    recorded: str | None = None
    predictions: str | None = None
    scene: str | None = None
    frames: Sequence[int] | None = None
    limit: int | None = 20
    device: str | None = None

    def __post_init__(self) -> None:
        """Check that the options fit together; raise UserError naming those that do not."""
        if self.predictions is not None and (self.run or self.recorded):
            raise UserError("predictions=... are shown as they are: leave run=... and recorded=... out")
        if not (self.run or self.recorded or self.predictions):
            raise UserError(
                "nothing to show: give run=runs/<run> (or run=tiny), recorded=<scenes> or predictions=<folder>; "
                "python src/view.py --help explains them"
            )
        if self.limit is not None and self.limit < 1:
            raise UserError(f"limit={self.limit}: give at least 1 frame, or limit=null for all")


def unique_names(runs: Sequence[str]) -> list[str]:
    """Return a short name for each run: its folder's, with a number where several have the same."""
    names: list[str] = []
    for run in runs:
        path = Path(run)
        name = path.parent.name if path.suffix and path.parent.name else path.name
        same = sum(other == name or other.startswith(f"{name} (") for other in names)
        names.append(f"{name} ({same + 1})" if same else name)
    return names
