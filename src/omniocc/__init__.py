"""Camera-based 3D semantic occupancy for vehicles with fisheye cameras."""

import sys
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from omniocc.predict.trained import load as load

__version__ = "0.1.0"


def __getattr__(name: str) -> Any:
    """Return `load`, whose module is imported when it is asked for: it takes seconds, and the metrics do without."""
    if name != "load":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from omniocc.predict.trained import load

    return load


def end_in_a_line(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    """Show Ctrl-C as a line, other errors as Python does."""
    if issubclass(kind, KeyboardInterrupt):
        print("stopped by Ctrl-C", file=sys.stderr)
    else:
        sys.__excepthook__(kind, error, trace)


# The scripts beside this package import for some tenths of a second before their main shows Ctrl-C itself.
if (
    Path(getattr(sys.modules["__main__"], "__file__", None) or "-").resolve().parent
    == Path(__file__).resolve().parents[1]
):
    sys.excepthook = end_in_a_line
